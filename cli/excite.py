"""The next recording: the motion that best tells the remaining explanations of a diagnosis apart.

Where `idapt diagnose` says that an effect could also be another, the recordings do not show enough. This
command searches the motion on which the explanations, each fitted again, disagree most in units of the
measurement noise, and which is safe under all of them. It writes next.csv (commands over time, for a robot
to play), next.html (start there), next.png, next.json and, if the model has a camera, next.gif. It says
which explanations no safe motion tells apart.

Limits are taken from the model (joint ranges, ctrlrange) and narrowed by options: one value for all, or NAME=VALUE.
See docs/guide/excite.md.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from tqdm import tqdm

from cli.arguments import keep_inputs, parser, show_bar
from idapt_pl.excitation.design import Goal
from idapt_pl.excitation.limits import ImpossibleMotion, MotionLimits, Span, limits_of
from idapt_pl.excitation.plan import MotionPlan, design_motion, read_base
from idapt_pl.excitation.report import motion_files, write_motion
from idapt_pl.excitation.rivals import LeftOpen, read_left_open
from idapt_pl.ranges import Range, check_ranges

EXAMPLES = """examples:
  idapt excite --model nominal.xml --report diagnosis --out next.csv
  idapt excite --model diagnosis/patched.xml --report diagnosis --out next.csv --velocity 1.5 --duration 8
  idapt excite --model nominal.xml --report diagnosis --out next.csv \\
      --position shoulder=-0.8:0.8 elbow=0:1.5 --velocity 2 wrist=4 --min-height 0.05
  idapt excite --model nominal.xml --report diagnosis --out next.csv --goal estimate
  idapt excite --model nominal.xml --report diagnosis --out next.csv --base policy_commands.csv
"""


def command_line() -> argparse.ArgumentParser:
    """The options of ``idapt excite``."""
    p = parser("excite", __doc__, EXAMPLES)
    p.add_argument("--model", type=Path, required=True, help="the model that was diagnosed, or its patched.xml")
    p.add_argument("--report", type=Path, required=True, metavar="DIR", help="folder that idapt diagnose wrote")
    p.add_argument("--out", type=Path, required=True, metavar="CSV", help="commands to play; the rest lies beside it")
    p.add_argument(
        "--goal", choices=[g.value for g in Goal], default=Goal.SEPARATE.value,
        help="separate: tell explanations apart; estimate: narrow the intervals of what was found (D-optimal); "
        "estimate-each: the same one by one (A-optimal)",
    )  # fmt: skip
    p.add_argument("--duration", type=float, default=10.0, metavar="S", help="of one play, s")
    p.add_argument("--rate", type=float, metavar="HZ", help="control rate (default: that of the recordings)")
    p.add_argument(
        "--fastest", type=float, metavar="HZ", help="highest frequency (default: 0.15 of the rate, at most 3)"
    )
    p.add_argument("--base", type=Path, metavar="CSV", help="commands that the motion is added to, such as a policy's")
    p.add_argument(
        "--start", type=float, nargs="+", metavar="Q", help="start pose, a number for each position of the model "
        "(default: its first keyframe, or its zero pose)",
    )  # fmt: skip
    spans = {
        "position": ("LOW:HIGH", "of joints, rad or m"),
        "velocity": ("MOST", "of joints, rad/s or m/s"),
        "command": ("LOW:HIGH", "of actuators, in their units"),
        "torque": ("MOST", "of actuators, before the gear, N·m or N"),
    }
    for name, (value, what) in spans.items():
        p.add_argument(f"--{name}", nargs="+", default=[], metavar=f"[NAME=]{value}", help=f"limit {what}")
    p.add_argument(
        "--contact", action=argparse.BooleanOptionalAction, default=False,
        help="parts may touch that do not touch at the start",
    )  # fmt: skip
    p.add_argument("--min-height", type=float, metavar="M", help="no moving part may go below this height, m")
    p.add_argument("--margin", type=float, default=0.05, help="share of the model's own ranges kept free at each end")
    p.add_argument("--rivals", type=int, default=5, metavar="N", help="consider so many explanations at most")
    p.add_argument("--seconds", type=float, default=90.0, metavar="S", help="aim for about so long on one free core")
    p.add_argument("--seed", type=int, default=0, help="of the search; the same seed finds the same motion")
    p.add_argument("--threads", type=int, default=None, help="for simulating; all cores if not given")
    return p


def main(args: list[str]) -> int:
    """Run ``idapt excite``; what cannot be asked is exit code 2."""
    o = command_line().parse_args([*map(no_option, args)])
    try:
        return run(o)
    except (ImpossibleMotion, ValueError) as error:
        print(f"idapt excite: {' '.join(str(error).split())}", file=sys.stderr)
        return 2


def no_option(argument: str) -> str:
    """A span that begins with a minus, as something that argparse does not take for an option."""
    return f" {argument}" if re.match(r"-[\d.]", argument) else argument


def run(o: argparse.Namespace) -> int:
    """Search a motion and write its files."""
    check_ranges(
        "", vars(o),
        {
            "seed": Range(0, 2**31 - 2), "threads": Range(1, 1024), "duration": Range(0.2, 600),
            "rate": Range(1, 10_000), "fastest": Range(0, 1000, "(]"), "margin": Range(0, 0.4), "rivals": Range(1, 20),
            "seconds": Range(1, 86_400),
        },
    )  # fmt: skip
    if o.out.suffix != ".csv":
        raise ValueError(f"{o.out}: --out must end in .csv; the picture and the page lie beside it")
    for file in motion_files(o.out):
        if file.is_dir():
            raise ValueError(f"{file}: is a folder, and a file of this name is to be written")
        keep_inputs(file, [o.model, o.base, *(o.report / n for n in ("report.json", "report.html"))])
    left_open = read_left_open(o.model, o.report)
    plan = plan_of(o, left_open)
    with tqdm(total=100, bar_format="{desc:<18} {percentage:3.0f}% |{bar}| {elapsed}", leave=False,
              disable=not show_bar()) as bar:  # fmt: skip

        def progress(what: str, done: float) -> None:
            bar.set_description_str(what, refresh=False)
            bar.n = max(bar.n, round(100 * done))
            bar.refresh()

        design, rivals, forecaster = design_motion(left_open, plan, progress, o.threads)
    entry = write_motion(o.out, design, rivals, forecaster, plan, left_open, o.model.name, o.report.name)
    console = Console()
    for sentence in entry["words"]:
        console.print(escape(sentence), soft_wrap=True, highlight=False)
    page = o.out.with_suffix(".html")
    console.print(f"{escape(str(o.out))} has the commands, {escape(page.name)} beside it the details", soft_wrap=True)
    return 0


def plan_of(o: argparse.Namespace, left_open: LeftOpen) -> MotionPlan:
    """What is asked, in the model's terms."""
    model = left_open.spec.copy().compile()
    if o.start is not None and len(o.start) != model.nq:
        raise ValueError(f"--start: expected {model.nq} positions, one for each of the model, got {len(o.start)}")
    rate = o.rate or 1 / left_open.measurement.control_period
    if o.fastest is not None and not 1 / o.duration <= o.fastest <= rate / 4:
        raise ValueError(
            f"--fastest: expected {1 / o.duration:.3g} (once in --duration) to {rate / 4:.3g} Hz (a quarter of the "
            f"control rate, {rate:g} Hz), got {o.fastest:g}"
        )
    return MotionPlan(
        limits=limits_from(o, left_open),
        duration=o.duration,
        control_rate=o.rate,
        fastest=o.fastest,
        goal=Goal(o.goal),
        start=None if o.start is None else np.array(o.start),
        base=None if o.base is None else read_base(o.base, model, 1 / rate),
        seconds=o.seconds,
        seed=o.seed,
        rivals=o.rivals,
    )


def limits_from(o: argparse.Namespace, left_open: LeftOpen) -> MotionLimits:
    """The limits of the options, within those of the model."""
    spans = {name: read_spans(name, getattr(o, name)) for name in ("position", "velocity", "command", "torque")}
    return limits_of(
        left_open.spec.copy().compile(), spans["position"], spans["velocity"], spans["command"], spans["torque"],
        not o.contact, o.min_height, o.margin,
    )  # fmt: skip


def read_spans(option: str, entries: list[str]) -> dict[str, Span]:
    """Limits as they are written: ``1.5``, ``-1:1``, ``elbow=2``, ``elbow=0:2``; without a name they are for all.

    Raises:
        ValueError: an entry cannot be read.
    """
    found: dict[str, Span] = {}
    for entry in entries:
        name, _, value = entry.rpartition("=")
        name, (low, _, high) = name.strip(), value.rpartition(":")
        try:
            top = float(high)
            span = (float(low) if low else -top, top)
        except ValueError:
            span = (np.nan, np.nan)
        if not span[0] < span[1]:
            raise ValueError(f"--{option}: expected a number above 0 or LOW:HIGH, with NAME= before it, got {entry!r}")
        found[name or "*"] = span
    return found
