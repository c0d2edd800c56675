"""Find the physical effects that a model lacks, from recordings of the real thing.

The recordings are replayed in the model in short windows from measured states. What the model gets
wrong is traced to an effect (friction, mass, delay, ...) by switching every effect on, refitting the
best and judging them on episodes that nothing was fitted to. DIR then holds report.html (start
there), report.json, patched.xml (the repaired model), effects.yaml and TensorBoard events.

Before any physics the recordings are tested for deployment faults: channels in another order, with
another sign, unit, zero or clock, a wrong control period, repeated samples. They are reported with
their cure; --fix takes them out, writes DIR/mended.h5 and goes on with that.

Stretches in which no model can hold (a push, a catch, motors off) are found and left out, or given by
--only and --without: comparisons of time [s], episode, actions[0] or any recorded channel. With several
files the common answer is fitted on all, and what differs between them is told.

With --run, recordings of images are read by the estimator of a run of idapt fit. Where that cannot
tell how fast things move, no windows are replayed: the recordings' commands are played from resets,
and effects are judged by how well that forecasts what is read (minutes, not seconds).
See docs/guide/diagnose.md and docs/guide/effects_from_images.md.
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from cli.arguments import keep_inputs, parser
from cli.diagnose_recordings import diagnose_recordings, progress_bar
from idapt_pl.diagnosis.answer.repaired import repair_model
from idapt_pl.diagnosis.answer.result import DiagnosisResult, EffectEstimate
from idapt_pl.diagnosis.search import Diagnosis, diagnose
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.effects.effects_file import read_effects
from idapt_pl.effects.wording import format_number, phrase_at
from idapt_pl.prediction.data import UnusableData
from idapt_pl.ranges import Range, check_ranges
from idapt_pl.report.change_section import change_sentences
from idapt_pl.report.diagnosis_files import write_diagnosis
from idapt_pl.report.diagnosis_wording import episode_list, error_rows, estimate_cells, verdict_in_words
from idapt_pl.report.explanation_section import not_named_sentences, probability_sentences
from idapt_pl.report.law_section import law_sentences
from idapt_pl.report.split_section import split_sentences

if TYPE_CHECKING:
    from idapt_pl.image_diagnosis import ImageDiagnosis

EXAMPLES = """examples:
  idapt diagnose --model nominal.xml --data measured.h5 --out diagnosis
  idapt diagnose --model nominal.xml --data measured.h5 --out diagnosis --fit 0 1 2 --hold-out 3
  idapt diagnose --model nominal.xml --data measured.h5 --out again --effects diagnosis/effects.yaml
  idapt diagnose --model nominal.xml --data measured.h5 --out diagnosis --fix
  idapt diagnose --model nominal.xml --data measured.h5 --out diagnosis --only '0.5 < time < 4' --without 'estop == 1'
  idapt diagnose --model nominal.xml --data monday.h5 tuesday.h5 friday.h5 --out week
  idapt diagnose --model robot.urdf --actuators position:kp=30,kv=1 --data measured.h5 --out diagnosis
  idapt diagnose --model nominal.xml --data measured.h5 --out friction \\
      --candidates joint_damping joint_frictionloss joint_stribeck
  idapt diagnose --model nominal.xml --data measured.h5 --out steady --splits
  idapt diagnose --run runs/inverted_pendulum_hard_0 --data images.h5 --out seen \\
      --candidates body_mass joint_damping actuator_gain

`idapt import` makes measured.h5 from CSV, JSON lines, ROS bags, ULog and more. An effects file is a list:
  - effect: joint_damping
    target: shoulder
    parameters: {damping: 0.06}
"""

WRITTEN = (
    "report.html", "report.json", "settings.md", "effects.yaml", "patched.xml", "unrepaired.xml",
    "looks.yaml", "looks.png", "mended.h5",
)  # fmt: skip
"""Files in the folder that a diagnosis writes."""


def command_line() -> argparse.ArgumentParser:
    """The options of ``idapt diagnose``."""
    p = parser("diagnose", __doc__, EXAMPLES)
    p.add_argument("--model", type=Path, help="nominal model (MJCF or URDF)")
    p.add_argument(
        "--actuators",
        metavar="KIND",
        help="of a model that has none: motor (torques), position:kp=30,kv=1, velocity:kv=2, none, or a YAML file",
    )
    p.add_argument("--run", type=Path, help="instead of --model: a run of idapt fit, whose estimator reads images")
    p.add_argument(
        "--data",
        type=Path,
        required=True,
        nargs="+",
        metavar="FILE",
        help="trajectory file with qpos (or images) and actions; with several, what differs between them is told",
    )
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the report")
    p.add_argument(
        "--fix", action="store_true", help="take deployment faults out of the recordings first (DIR/mended.h5)"
    )
    p.add_argument(
        "--only", action="append", default=[], metavar="CONDITION", help="use these stretches alone: 'state == 2'"
    )
    p.add_argument(
        "--without", action="append", default=[], metavar="CONDITION", help="leave these stretches out: 'estop == 1'"
    )
    p.add_argument("--keep-all", action="store_true", help="do not look for stretches in which the model cannot hold")
    p.add_argument("--effects", type=Path, metavar="YAML", help="effects known already, applied throughout")
    p.add_argument("--fit", type=int, nargs="+", metavar="EPISODE", help="episodes to fit on (default: the others)")
    p.add_argument(
        "--hold-out", type=int, nargs="+", metavar="EPISODE", help="episodes to judge on (default: every fourth)"
    )
    add_search_options(p)
    return p


def add_search_options(p: argparse.ArgumentParser) -> None:
    """What is looked for, and how hard."""
    p.add_argument(
        "--candidates",
        nargs="+",
        metavar="EFFECT",
        help="consider these effects alone (default: all; by forecasts, those of idapt fit)",
    )
    p.add_argument(
        "--max-effects", type=int, default=SearchSettings.max_effects, metavar="N", help="stop after so many"
    )
    p.add_argument(
        "--looks", action="store_true", help="with --run: visual effects too, from the episodes' first frames"
    )
    p.add_argument("--quick", action="store_true", help="a first answer, in about 20 s; it says what was not tried")
    p.add_argument(
        "--fdr",
        type=float,
        metavar="RATE",
        help="name only effects of which at most this share is expected to be false",
    )
    p.add_argument(
        "--splits",
        action="store_true",
        help="search again with each other quarter of the episodes held out, and tell how often each effect is chosen "
        "(four times as long)",
    )
    p.add_argument("--no-laws", action="store_true", help="look for no law of force where much stays unexplained")
    p.add_argument("--seed", type=int, default=0, help="of the choice of windows")
    p.add_argument("--threads", type=int, default=None, help="for simulating; all cores if not given")


def main(args: list[str]) -> int:
    """Run ``idapt diagnose``."""
    p = command_line()
    o = p.parse_args(args)
    if o.max_effects < 1:
        p.error(f"--max-effects must be at least 1, got {o.max_effects}")
    if o.out.exists() and not o.out.is_dir():
        raise ValueError(f"{o.out}: --out is a file; name a folder")
    for name in (*WRITTEN, *(f"mended_{i}.h5" for i in range(len(o.data)))):
        keep_inputs(o.out / name, [o.model, *o.data, o.effects])
    keep_inputs(o.out, [o.run])
    check_ranges("", vars(o), {"seed": Range(0, 2**31 - 1), "threads": Range(1, 1024), "fdr": Range(0, 1, "()")})
    if (o.model is None) == (o.run is None):
        p.error("give either --model (recordings of positions) or --run (recordings of images)")
    if o.looks and o.run is None:
        p.error("--looks compares images with what the source of a run shows: give --run")
    if o.fix and o.run is not None:
        p.error("--fix mends recordings of positions: give --model, not --run")
    if o.fdr is not None and o.run is not None:
        p.error("--fdr is for recordings of positions: give --model")
    if o.quick and o.run is not None:
        p.error("--quick is for recordings of positions: give --model")
    if o.splits and (o.run is not None or o.quick):
        p.error("--splits searches recordings of positions again: give --model, and not --quick")
    if o.splits and (o.fit or o.hold_out):
        p.error("--splits holds out each quarter of the episodes in turn: not with --fit or --hold-out")
    if o.run is not None and (o.only or o.without or o.actuators or len(o.data) > 1):
        p.error("--only, --without, --actuators and several files are for recordings of positions: give --model")
    if o.run is None:
        o.mending = shlex.join(["idapt", "diagnose", *args, "--fix"])
        print_diagnosis(diagnose_recordings(o), o.out)
        return 0
    return diagnose_run(o)


def diagnose_run(o: argparse.Namespace) -> int:
    """`idapt diagnose --run`: recordings of images, by a run's networks; recordings of positions need no torch."""
    from cli.diagnose_images import diagnose_images_by_forecasts, read_images, report_visual_effects
    from idapt_pl.run import Run

    run, (data,) = Run.open(o.run), o.data
    images = read_images(run, data)
    if o.looks:
        report_visual_effects(run, data, o.out, o.seed)
    source = run.worlds.source_domain
    model, how = source.within_mjcf.spec(), images.diagnose_arguments(source)
    declared = read_effects(o.effects, model) if o.effects else ()
    given = (*source.beyond_mjcf, *declared)
    if images.readings.calibration.velocities_unreliable:
        print_forecast_diagnosis(diagnose_images_by_forecasts(run, images, o, declared), model.compile(), o.out)
        return 0
    try:
        with progress_bar() as progress:
            diagnosis = diagnose(
                model, images.readings.target, given, o.fit, o.hold_out, o.candidates, o.seed,
                replace(SearchSettings(), max_effects=o.max_effects), progress, o.threads,
                laws=not o.no_laws, **how,
            )  # fmt: skip
    except UnusableData as error:
        raise ValueError(f"{data}: {error}") from None
    write_diagnosis(diagnosis, o.out, o.run.name, data.name)
    print_diagnosis(diagnosis, o.out)
    return 0


def print_diagnosis(diagnosis: Diagnosis, out: Path) -> None:
    """The verdict, the errors, the effects, and where the rest is."""
    result, model = diagnosis.result, diagnosis.sim.model
    held_out, unit = episode_list(result.error.held_out_episodes), result.error.yardstick
    errors = Table(title=f"error on held-out {held_out} (1 = {unit})")
    for title, how in (("", "left"), ("error", "right"), ("", "left")):
        errors.add_column(title, justify=how)
    for name, value, what in error_rows(result):
        errors.add_row(name, format_number(value), what)
    tables = [errors, *effects_tables(result.effects, model)]
    notes = {"the rest": result.signature, "next": result.next_experiment}
    print_findings([*verdict_in_words(result, model), *more_sentences(result)], tables, out, notes)
    if unsaid := repair_model(diagnosis.sim.spec, diagnosis.effects, out).unsaid:
        names = ", ".join(phrase_at(e.name, e.target) for e in unsaid)
        words = f"not in patched.xml, as MJCF has no words for it: {escape(names)}"
        Console().print(words, soft_wrap=True)


def more_sentences(result: DiagnosisResult) -> list[str]:
    """How probable it is, what changes, and laws for what no effect explains."""
    told = [*probability_sentences(result.explanations, result.error), *not_named_sentences(result)]
    if result.not_tried:
        told.append(f"A quick look. Not tried: {', '.join(result.not_tried)}. For these run it without --quick.")
    told += split_sentences(result.splits)
    return [*told, *change_sentences(result.changes), *law_sentences(result.laws)]


def print_forecast_diagnosis(diagnosis: ImageDiagnosis, model: mujoco.MjModel, out: Path) -> None:
    """The verdict and the effects of a diagnosis by forecasts, and where the rest is; ``model`` is the source's."""
    from idapt_pl.report.forecast_page import forecast_verdict

    print_findings(forecast_verdict(diagnosis, model), effects_tables(diagnosis.believed, model), out, {})


def print_findings(verdict: Sequence[str], tables: Sequence[Table], out: Path, notes: Mapping[str, str]) -> None:
    """The verdict in words, tables, what there is to note, and where the rest is."""
    console = Console()
    for sentence in verdict:
        console.print(escape(sentence), soft_wrap=True, highlight=False)
    for table in tables:
        console.print(table)
    for name, text in notes.items():
        if text:
            console.print(f"{name}: {escape(text)}", soft_wrap=True, highlight=False)
    told = f"{escape(str(out / 'report.html'))} has the details, patched.xml beside it the repaired model"
    console.print(told, soft_wrap=True, highlight=False)


def effects_tables(effects: Sequence[EffectEstimate], model: mujoco.MjModel) -> list[Table]:
    """A table with a row for each parameter of each effect; none where there are no effects."""
    table = Table(title="effects to add")
    table.add_column("effect")
    for title in ("estimate (95 %)", "in the model", "probable"):
        table.add_column(title, justify="right", no_wrap=True)  # what gets narrow is the words
    for e in effects:
        sure = "" if e.probability is None else f"{e.probability:.0%}"
        for parameter, value, interval, unit, nominal in estimate_cells(e, model):
            estimate = f"{value} {unit}".strip() + (f"\n{interval}" if interval != "-" else "")
            table.add_row(*map(escape, (f"{phrase_at(*e.key)}: {parameter}", estimate, nominal, sure)))
    return [table] if effects else []
