"""`idapt diagnose --model`: recordings of positions, in one file or several."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tqdm import tqdm
from tqdm.contrib.logging import logging_redirect_tqdm

from cli.arguments import show_bar
from datamodules import Trajectories, read_trajectories, write_trajectories
from datamodules.trajectories import cut_in_time
from idapt_pl.deployment_faults import FaultReport, find_deployment_faults
from idapt_pl.diagnosis.candidates.held_joints import hold_still_joints, release
from idapt_pl.diagnosis.claims import claim
from idapt_pl.diagnosis.search import Diagnosis, diagnose, with_laws
from idapt_pl.diagnosis.splits import with_splits
from idapt_pl.diagnosis.state.settings import DEFAULT_SETTINGS, QUICK_SETTINGS, SearchSettings
from idapt_pl.effects.effects_file import read_effects
from idapt_pl.prediction.data import UnusableData
from idapt_pl.recording_sets import RecordingSet, SetComparison, compare_sets, join_recordings
from idapt_pl.report.diagnosis_files import RecordingNotes, held_sentence, write_diagnosis
from idapt_pl.report.fault_section import consequence, fault_sentence
from idapt_pl.report.sets_section import comparison_sentences, set_cells, set_heads
from idapt_pl.report.stretch_section import stretch_sentences
from idapt_pl.robot_files.actuators import parse_actuators
from idapt_pl.robot_files.read import read_robot
from idapt_pl.stretches import diagnose_stretches, mark_by_conditions
from idapt_pl.stretches.conditions import BadCondition, idle_conditions
from idapt_pl.stretches.stretch import marked_steps

log = logging.getLogger(__name__)


def diagnose_recordings(o: argparse.Namespace) -> Diagnosis:
    """Everything that `idapt diagnose --model` does up to the files; tells of faults, stretches and files on the way.

    Args:
        o: the command's options, and ``mending``, the same command with ``--fix``.

    Raises:
        ValueError: of what the user gave, naming the file or the option.
    """
    robot = read_robot(o.model, None if o.actuators is None else parse_actuators(o.actuators))
    model = robot.spec
    for note in robot.notes:
        Console().print(escape(f"{o.model.name}: {note}"), soft_wrap=True, highlight=False)
    declared = read_effects(o.effects, model) if o.effects else ()
    each = read_recordings(o)
    ask_for_actuators(o, model, each)
    joined, named = join_recordings(o.data, each)
    names = [s.name for s in named]
    if held := hold_still_joints(model, joined):
        Console().print(escape(held_sentence(held)), soft_wrap=True, highlight=False)
    each, faults = without_faults(model, each, names, o)
    if o.fix:
        model = one_mended_model(model, faults)
    data, sets = join_recordings(o.data, each)
    if o.fix:  # columns may be other joints' now
        held = hold_still_joints(release(model), data)
    data = more_than_one(data)

    with progress_bar() as progress:

        def run(recordings: Trajectories) -> Diagnosis:
            return diagnose(
                model, recordings, declared, o.fit, o.hold_out, o.candidates, o.seed,
                search_settings(o), progress, o.threads, unmeasured=tuple(held), laws=False,
            )  # fmt: skip

        try:
            end = partial(finish, o=o)
            diagnosis, stretches = diagnose_stretches(run, data, conditions_of(o), not (o.keep_all or o.quick), end)
            comparison = compare_sets(diagnosis, sets) if len(sets) > 1 else None
        except UnusableData as error:
            raise ValueError(f"{', '.join(map(str, o.data))}: {error}") from None
    fixed = o.fix and any(f.faults for f in faults.values())
    if not o.fix and any(f.faults for f in faults.values()):
        first = FAULTS_FIRST.format(command=o.mending)
        diagnosis = replace(diagnosis, result=replace(diagnosis.result, next_experiment=first, mending=o.mending))
    notes = RecordingNotes(faults, fixed, stretches, comparison, robot.notes, held)
    write_diagnosis(diagnosis, o.out, o.model.name, " + ".join(names), notes)
    for path, recordings in mended_files(o.out, sets, each) if fixed else ():
        write_trajectories(path, recordings)
    for sentence in stretch_sentences(stretches):
        Console().print(escape(sentence), soft_wrap=True, highlight=False)
    print_comparison(comparison)
    return diagnosis


def search_settings(o: argparse.Namespace) -> SearchSettings:
    """How hard to look: as many effects as were asked for, in a quick look no more than it has time for."""
    if not o.quick:
        return replace(DEFAULT_SETTINGS, max_effects=o.max_effects)
    return replace(QUICK_SETTINGS, max_effects=min(o.max_effects, QUICK_SETTINGS.max_effects))


def finish(found: Diagnosis, o: argparse.Namespace) -> Diagnosis:
    """Look for laws, once pushes are left out, which must not be taken for laws; then name what is sure enough."""
    found = with_splits(found) if o.splits else found
    found = found if o.no_laws or o.quick else with_laws(found)
    return found if o.fdr is None else claim(found, o.fdr)


FAULTS_FIRST = (
    "nothing yet: give the same command with --fix first, as effects that were found beside faults may be theirs: "
    "{command}"
)
"""What to record next where deployment faults were found, and left as they are."""

PARTS = 4
"""That a single episode is cut into: three to fit, one to judge on."""


def more_than_one(data: Trajectories) -> Trajectories:
    """Recordings of several episodes; a single one is cut in time, if enough of it is kept, and the user told where.

    What is kept is shared out equally: else all of it may lie in one part.
    """
    if len(data) != 1:
        return data
    kept = np.flatnonzero(~marked_steps(data.episodes[0]))
    if len(kept) < 20 * PARTS:
        return data
    edges = [0, *(int(kept[k * len(kept) // PARTS]) for k in range(1, PARTS)), len(data.episodes[0])]
    parts = cut_in_time(data, edges)
    seconds = " s, ".join(f"{k} from {time_of(data, first):.4g}" for k, first in enumerate(edges[:-1]))
    text = f"one episode: cut in time into {PARTS}, as some must be held out: episode {seconds} s on"
    Console().print(text, soft_wrap=True, highlight=False)
    return parts


def time_of(data: Trajectories, row: int) -> float:
    """Of a row of the first episode, since that began, s."""
    stamps = data.episodes[0].timestamps
    return row * data.dt if stamps is None else float(stamps[row] - stamps[0])


def ask_for_actuators(o: argparse.Namespace, model: mujoco.MjSpec, each: Sequence[Trajectories]) -> None:
    """See that a model without actuators has no commands to follow.

    Raises:
        ValueError: it has; the message says what to declare.
    """
    columns = max((e.actions.shape[1] for data in each for e in data), default=0)
    if columns and not len(model.actuators) and o.actuators is None:
        joints = ", ".join(j.name for j in model.joints)
        raise ValueError(
            f"{o.model}: it has no actuators, but the recordings have {columns} columns of actions: say what they are "
            f"with --actuators motor (torques), --actuators position:kp=30,kv=1 (targets of servos), or a YAML file "
            f"that names a joint for each column (joints: {joints})"
        )


def read_recordings(o: argparse.Namespace) -> list[Trajectories]:
    """The files, with what is to be left out marked; the user is told of conditions that leave nothing out.

    Raises:
        ValueError: the files do not go together, or a condition does not fit them.
    """
    each = [read_trajectories(path) for path in o.data]
    data, sets = join_recordings(o.data, each)
    try:
        marked = mark_by_conditions(data, o.only, o.without)
    except BadCondition as error:
        raise ValueError(f"{', '.join(map(str, o.data))}: {error}") from None
    for sentence in idle_conditions(data, o.only, o.without):
        Console().print(escape(sentence), soft_wrap=True, highlight=False)
    return [replace(d, episodes=marked.episodes[s.first : s.last]) for d, s in zip(each, sets, strict=True)]


def conditions_of(o: argparse.Namespace) -> tuple[str, ...]:
    """Conditions as they were given."""
    return (*(f"only {c}" for c in o.only), *(f"without {c}" for c in o.without))


def mended_files(
    out: Path, sets: Sequence[RecordingSet], each: Sequence[Trajectories]
) -> list[tuple[Path, Trajectories]]:
    """Where mended recordings go: mended.h5, or one for each file."""
    if len(sets) == 1:
        return [(out / "mended.h5", each[0])]
    return [(out / f"mended_{i}.h5", data) for i, data in enumerate(each)]


def without_faults(
    model: mujoco.MjSpec, each: Sequence[Trajectories], names: Sequence[str], o: argparse.Namespace
) -> tuple[list[Trajectories], dict[str, FaultReport]]:
    """Test every file for deployment faults and say what was found; with ``--fix``, the mended recordings.

    Raises:
        ValueError: the recordings do not fit the model, or an episode is too short for a shift that would mend it.
    """
    reports, mended = {}, list(each)
    for i, (path, name, data) in enumerate(zip(o.data, names, each, strict=True)):
        try:
            with progress_bar() as progress:
                reports[name] = report = find_deployment_faults(model, data, o.seed, progress)
        except UnusableData as error:
            raise ValueError(f"{path}: {error}") from None
        for fault in report.faults:
            of = f"{name}: " if len(names) > 1 else ""
            Console().print(escape(of + fault_sentence(fault)), soft_wrap=True, highlight=False)
        if o.fix:
            try:
                mended[i] = report.fixed(data)
            except ValueError as error:
                raise ValueError(f"{path}: --fix: {error}") from None
    if any(r.faults for r in reports.values()):
        Console().print(escape(consequence(o.fix)), soft_wrap=True, highlight=False)
        if not o.fix:
            Console().print(escape(f"The first thing to do: {o.mending}"), soft_wrap=True, highlight=False)
            log.info("deployment faults are in the recordings; the first thing to do: %s", o.mending)
    return mended, reports


def one_mended_model(model: mujoco.MjSpec, faults: dict[str, FaultReport]) -> mujoco.MjSpec:
    """The model with faults of its own taken out.

    Raises:
        ValueError: by some recordings it has other faults than by others.
    """
    mends = {name: (r.mend.drives, r.mend.gravity) for name, r in faults.items()}
    if len({(bool(d), g) for d, g in mends.values()}) > 1:
        told = ", ".join(n for n, (d, g) in mends.items() if d or g)
        raise ValueError(f"--fix: the model's drives or gravity are wrong by some of the recordings only ({told})")
    return next(iter(faults.values())).fixed_model(model)


def print_comparison(comparison: SetComparison | None) -> None:
    """A row for each file, and what changed."""
    if comparison is None:
        return
    table = Table(title="file by file")
    for i, head in enumerate(set_heads(comparison)):
        table.add_column(escape(head), justify="left" if i < 2 else "right", overflow="fold")
    for r in comparison.sets:
        table.add_row(*map(escape, set_cells(r, comparison)))
    Console().print(table)
    for sentence in comparison_sentences(comparison):
        Console().print(escape(sentence), soft_wrap=True, highlight=False)


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """A bar for the diagnosis to report to."""
    layout = "{desc:<22} {percentage:3.0f}% |{bar}| {elapsed}"
    with tqdm(total=100, bar_format=layout, leave=False, disable=not show_bar()) as bar, logging_redirect_tqdm():

        def report(what: str, done: float) -> None:
            bar.set_description_str(what, refresh=False)
            bar.n = max(bar.n, round(100 * done)) if done > 0.1 else round(100 * done)  # it may begin anew
            bar.refresh()

        yield report
