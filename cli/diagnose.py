"""Find the physical effects that a model lacks, from recordings of the real thing.

The recordings are replayed in the model in short windows from measured states. What the model gets
wrong is traced to an effect (friction, mass, delay, ...) by switching every effect on, refitting the
best and judging them on episodes that nothing was fitted to. DIR then holds report.html (start
there), report.json, patched.xml (the repaired model), effects.yaml and TensorBoard events.
See docs/diagnose.md.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import mujoco
import yaml
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tqdm import tqdm
from tqdm.contrib.logging import logging_redirect_tqdm

from cli.arguments import parser, show_bar
from cli.run_folder import load_estimator, load_visual, open_run
from datamodules import Trajectories, read_trajectories
from idapt_pl.appearance import discover_looks
from idapt_pl.diagnosis import Diagnosis, diagnose
from idapt_pl.diagnosis.data import UnusableData
from idapt_pl.diagnosis.model import read_model
from idapt_pl.diagnosis.repaired import repair
from idapt_pl.diagnosis.report import write_report
from idapt_pl.diagnosis.state import Settings
from idapt_pl.diagnosis.words import episodes, error_rows, estimate, meaning, number, unit_at, verdict_in_words
from idapt_pl.domains import Effect, effect_from_dict
from idapt_pl.files import write_atomically
from idapt_pl.grounding import IterativeGrounding
from idapt_pl.sensing import Sensor, read_calibrated

EXAMPLES = """examples:
  idapt diagnose --model nominal.xml --data measured.h5 --out diagnosis
  idapt diagnose --model nominal.xml --data measured.h5 --out diagnosis --fit 0 1 2 --hold-out 3
  idapt diagnose --model nominal.xml --data measured.h5 --out again --effects diagnosis/effects.yaml
  idapt diagnose --model nominal.xml --data measured.h5 --out friction \\
      --candidates joint_damping joint_frictionloss joint_stribeck
  idapt diagnose --run runs/inverted_pendulum_hard_0 --data images.h5 --out seen \\
      --candidates body_mass joint_damping actuator_gain

`idapt import` makes measured.h5 from CSV, NPZ, Minari, LeRobot or MCAP. An effects file is a list:
  - effect: joint_damping
    target: shoulder
    parameters: {damping: 0.06}
"""


def main(args: list[str]) -> int:
    """Run ``idapt diagnose``."""
    p = parser("diagnose", __doc__, EXAMPLES)
    p.add_argument("--model", type=Path, help="nominal model (MJCF)")
    p.add_argument("--run", type=Path, help="instead of --model: a run of idapt fit, whose estimator reads images")
    p.add_argument("--data", type=Path, required=True, help="trajectory file with qpos (or images) and actions")
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the report")
    p.add_argument("--effects", type=Path, metavar="YAML", help="effects known already, applied throughout")
    p.add_argument("--fit", type=int, nargs="+", metavar="EPISODE", help="episodes to fit on (default: the others)")
    p.add_argument(
        "--hold-out", type=int, nargs="+", metavar="EPISODE", help="episodes to judge on (default: every fourth)"
    )
    p.add_argument("--candidates", nargs="+", metavar="EFFECT", help="consider these effects alone (default: all)")
    p.add_argument("--max-effects", type=int, default=Settings.max_effects, metavar="N", help="stop after so many")
    p.add_argument(
        "--looks", action="store_true", help="with --run: visual effects too, from the episodes' first frames"
    )
    p.add_argument("--seed", type=int, default=0, help="of the choice of windows")
    p.add_argument("--threads", type=int, default=None, help="for simulating; all cores if not given")
    o = p.parse_args(args)
    if o.max_effects < 1:
        p.error(f"--max-effects must be at least 1, got {o.max_effects}")
    if o.out.exists() and not o.out.is_dir():
        raise ValueError(f"{o.out}: --out is a file; name a folder")
    if (o.model is None) == (o.run is None):
        p.error("give either --model (recordings of positions) or --run (recordings of images)")
    if o.looks and o.run is None:
        p.error("--looks compares images with what the source of a run shows: give --run")
    if o.run is None:
        model, trajectories, how = read_model(o.model), read_trajectories(o.data), {}
    else:
        grounding = open_run(o.run)
        if o.looks:
            report_looks(grounding, o.data, o.out, o.seed)
        model, trajectories, how = read_images(grounding, o.data)
    declared = read_effects(o.effects, model) if o.effects else ()
    try:
        with progress_bar() as progress:
            diagnosis = diagnose(
                model, trajectories, declared, o.fit, o.hold_out, o.candidates, o.seed,
                replace(Settings(), max_effects=o.max_effects), progress, o.threads, **how,
            )  # fmt: skip
    except UnusableData as error:
        raise ValueError(f"{o.data}: {error}") from None
    write_report(diagnosis, o.out, (o.model or o.run).name, o.data.name)
    print_diagnosis(diagnosis, o.out)
    return 0


def report_looks(grounding: IterativeGrounding, data: Path, out: Path, seed: int) -> None:
    """Say which visual effects the source of a run lacks; write ``looks.yaml`` and ``looks.png``.

    Every episode must begin as the task's do.
    """
    worlds, console = grounding.worlds, Console()
    found = discover_looks(worlds.task, worlds.source_domain, data, seed, worlds.view)
    out.mkdir(parents=True, exist_ok=True)
    write_atomically(out / "looks.yaml", lambda path: path.write_text(yaml.safe_dump(found["effects"])))
    write_atomically(out / "looks.png", lambda path: path.write_bytes(base64.b64decode(found["picture"])))
    names = ", ".join(f"{e['effect']} of {e['target']}" for e in found["estimates"]) or "none was found"
    before, after, floor = (number(found[k]) for k in ("before", "after", "floor"))
    for sentence in (
        f"visual effects that the source lacks: {names}.",
        f"The recording's first frames are {before} levels of 255 from the source's, {after} with these effects; noise "
        f"alone makes {floor}. {out / 'looks.png'} shows source, source with the effects, recording.",
    ):
        console.print(escape(sentence), soft_wrap=True, highlight=False)


def read_images(grounding: IterativeGrounding, data: Path) -> tuple[mujoco.MjSpec, Trajectories, dict]:
    """The source of a run, recordings of images as its sensor reads them, and how that reads (for ``diagnose``).

    The sensor is the estimator of the run's last grounding step. Its errors on images of the source count as noise,
    although they depend on the state and are not white: see decision 17.
    """
    worlds = grounding.worlds
    domain, sensor = worlds.source_domain, Sensor(load_estimator(grounding), worlds.task, worlds.frame_stack)
    run = grounding.stages.run_dir  # the sensor was not fitted to the control, where the run has one
    newest = [*run.glob("step_00/source.h5"), *sorted(run.glob("step_*/control.h5"))][-1]
    readings = read_calibrated(sensor, domain, [data], [newest], load_visual(grounding), grounding.stages.seed)
    noise = readings.calibration.noise(domain.compile(), worlds.task.unseen)
    how = {"noise": noise, "unmeasured": readings.unmeasured}
    return domain.spec(), readings.target, how


def read_effects(path: Path, model: mujoco.MjSpec) -> tuple[Effect, ...]:
    """The effects in a YAML list, each tried on the model.

    Raises:
        ValueError: naming the file, the entry and what is known.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file; expected a list of effects (YAML)")
    try:
        entries = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from None
    if not isinstance(entries, list):
        raise ValueError(f"{path}: expected a list of effects, got {type(entries).__name__}; see idapt diagnose --help")
    spec, effects = model.copy(), []
    for i, entry in enumerate(entries):
        try:
            effects.append(read_effect(entry))
            effects[-1].apply(spec)
            spec.copy().compile()
        except ValueError as error:
            raise ValueError(f"{path}: entry {i}: {' '.join(str(error).split())}") from None
    return tuple(effects)


def read_effect(entry: object) -> Effect:
    """One entry of an effects file."""
    if isinstance(entry, Mapping):
        if not isinstance(entry.get("effect", ""), str):
            raise ValueError(f"effect must be a name, got {entry['effect']!r}")
        if not isinstance(entry.get("target", ""), str):
            raise ValueError(f"effect {entry['effect']!r}: target must be a name, got {entry['target']!r}")
        if not isinstance(entry.get("parameters", {}), Mapping):
            raise ValueError(f"parameters must be names with values, got {entry['parameters']!r}")
    return effect_from_dict(entry)


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """A bar for the diagnosis to report to."""
    layout = "{desc:<22} {percentage:3.0f}% |{bar}| {elapsed}"
    with tqdm(total=100, bar_format=layout, leave=False, disable=not show_bar()) as bar, logging_redirect_tqdm():

        def report(what: str, share: float) -> None:
            bar.set_description_str(what, refresh=False)
            bar.n = max(bar.n, round(100 * share))
            bar.refresh()

        yield report


def print_diagnosis(diagnosis: Diagnosis, out: Path) -> None:
    """The verdict, the errors, the effects, and where the rest is."""
    report, model, console = diagnosis.report, diagnosis.sim.model, Console()
    for sentence in verdict_in_words(report, model):
        console.print(escape(sentence), soft_wrap=True, highlight=False)
    errors = Table(title=f"error on held-out {episodes(report['error']['held_out_episodes'])} (1 = measurement noise)")
    for title, how in (("", "left"), ("error", "right"), ("", "left")):
        errors.add_column(title, justify=how)
    for name, value, what in error_rows(report):
        errors.add_row(name, number(value), what)
    console.print(errors)
    if report["effects"]:
        console.print(effects_table(report, model))
    if report["signature"]:
        console.print(f"the rest: {escape(report['signature'])}", soft_wrap=True, highlight=False)
    if report["next_experiment"]:
        console.print(f"next: {escape(report['next_experiment'])}", soft_wrap=True, highlight=False)
    if unsaid := repair(diagnosis.sim.spec, diagnosis.effects, out).unsaid:
        names = ", ".join(meaning(e.name, e.target) for e in unsaid)
        console.print(f"not in patched.xml, as MJCF has no words for it: {escape(names)}", soft_wrap=True)
    console.print(f"{escape(str(out / 'report.html'))} has the details, patched.xml beside it the repaired model",
                  soft_wrap=True, highlight=False)  # fmt: skip


def effects_table(report: dict, model: mujoco.MjModel) -> Table:
    """A row a parameter."""
    table = Table(title="effects to add")
    for title, how in (
        ("effect", "left"), ("parameter", "left"), ("estimate", "right"), ("95 %", "right"), ("unit", "left"),
        ("in the model", "right"),
    ):  # fmt: skip
        table.add_column(title, justify=how, overflow="fold")
    for e in report["effects"]:
        for name, p in e["parameters"].items():
            value, interval = estimate(p["estimate"], p["ci95"])
            nominal = p["nominal"] if isinstance(p["nominal"], str) else number(p["nominal"])
            cells = (meaning(e["effect"], e["target"]), name, value, interval or "-",
                     unit_at(model, e["target"], p["unit"]), nominal)  # fmt: skip
            table.add_row(*map(escape, cells))
    return table
