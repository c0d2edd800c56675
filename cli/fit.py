"""``idapt fit``: Algorithm 1 as a LightningCLI application."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import lightning as L
import yaml
from jsonargparse import Namespace
from lightning.pytorch.callbacks import TQDMProgressBar
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from lightning.pytorch.utilities.exceptions import MisconfigurationException

from cli.aside import OtherProcesses, processes_beside
from cli.interrupt import resumable
from cli.provenance import claim, write_provenance
from cli.run_folder import resumed_in_place
from cli.table import print_summary
from idapt_pl.baselines.oracle import train_oracle
from idapt_pl.files import read_yaml, write_yaml
from idapt_pl.image_diagnosis.known_effects import fill_known
from idapt_pl.randomisation.settings import fill_ranges
from idapt_pl.report.run_page import write_run_report
from idapt_pl.run import Run
from idapt_pl.run_config import RunConfig, usual_folder
from idapt_pl.run_folder.kept_config import without_retired
from idapt_pl.run_folder.kept_warnings import keeping_warnings
from idapt_pl.run_folder.time_left import TimeLeft, expected_seconds
from idapt_pl.stage import stage_trainer_settings
from idapt_pl.stages.aside import Aside, in_turn
from idapt_pl.stages.schedule import fill_lengths
from idapt_pl.stages.shortened import shorten

log = logging.getLogger(__name__)


class StageProgressBar(TQDMProgressBar):
    """A progress bar that names the stage."""

    def __init__(self, title: str) -> None:
        super().__init__(refresh_rate=10)
        self.title = title

    @property
    def train_description(self) -> str:
        return self.title


class GroundingCLI(LightningCLI):
    """One config key for each thing there is: the run, its schedule, the four modules, the Trainer."""

    def __init__(self, args: list[str] | Namespace, shows_bars: bool | None = None) -> None:
        self.shows_bars = sys.stderr.isatty() if shows_bars is None else shows_bars
        sys.argv = ["idapt fit"]  # LightningCLI warns when it is given arguments beside the process's own
        super().__init__(
            args=args,
            run=False,
            save_config_callback=None,
            auto_configure_optimizers=False,
            seed_everything_default=False,
            parser_kwargs={"prog": "idapt fit", "description": __doc__, "exit_on_error": False, "allow_abbrev": False},
        )

    def add_core_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        RunConfig.add_arguments(parser)
        parser.add_lightning_class_args(L.Trainer, "trainer")
        parser.set_defaults({"trainer.devices": 1})

    def instantiate_classes(self) -> None:
        self.config.trainer.devices = one_device(self.config.trainer)
        fill_lengths(self.config.schedule, self.config.task, self.config.target)
        self.shortened_by = shorten(self.config)
        if self.shortened_by != 1 and self.config.run_dir is None:
            self.config.run_dir = usual_folder(self.config.task, self.config.target, self.config.seed) + "_short"
        fill_known(self.config.effects)
        fill_ranges(self.config.randomisation, self.config.task)
        self.config_init = self.parser.instantiate_classes(self.config)
        try:
            self.instantiate_trainer(logger=False)  # what it does not take is better said now
        except MisconfigurationException as error:
            raise ValueError(f"trainer: {error}") from None

    def run(self, aside: Aside | None = None) -> Run:
        """The run that the config describes; by default its work is set aside as the config says."""
        config = RunConfig.from_namespace(self.config_init)
        if aside is None:
            processes = processes_beside(config.side_by_side)
            aside = OtherProcesses(config.folder, processes) if processes else in_turn
        return Run.create(config, self.trainer_for, aside)

    def trainer_for(self, folder: Path, batches: int) -> L.Trainer:
        """A fresh Trainer for one stage; its metrics go to the stage's folder."""
        step, name = folder.parent.name, folder.name
        return self.instantiate_trainer(
            logger=[TensorBoardLogger(folder, name="", version=""), CSVLogger(folder, name="", version="")],
            callbacks=[StageProgressBar(f"{step} {name}")] if self.shows_bars else [],
            **stage_trainer_settings(folder, batches, self.shows_bars),
        )


def one_device(trainer: Namespace) -> int | str | list[int]:
    """Which device to train on: the stages act and learn in turn, in this one process.

    Raises:
        ValueError: if there are to be several.
    """
    devices = 1 if trainer.devices == "auto" else trainer.devices
    count = len(devices) if isinstance(devices, list) else devices
    if str(count) != "1" or trainer.num_nodes != 1:
        raise ValueError(
            f"trainer.devices is {devices}, trainer.num_nodes {trainer.num_nodes}, but a run acts and learns in turn "
            "in one process: give 1 of each, or the device to take, such as [0]. Several seeds can run side by side"
        )
    return devices


def current(argument: str) -> str:
    """A config of an earlier version as text that this one parses; any other argument as it is."""
    option, path = "--config=" * argument.startswith("--config="), Path(argument.removeprefix("--config="))
    if path.name != "config.yaml" or not path.is_file():
        return argument
    try:
        entries = read_yaml(path)
    except ValueError:
        return argument  # the parser says what is wrong with it
    kept = without_retired(entries) if isinstance(entries, dict) else entries
    return argument if kept == entries else option + yaml.safe_dump(kept, sort_keys=False)


def open_aside(folder: Path, aside: Aside) -> Run:
    """The run of a folder as ``idapt fit`` runs it, with one thread and no bar, for a process that works beside it."""
    alone = [f"--run_dir={folder}", "--threads=1", "--render_processes=0"]
    return GroundingCLI(["--config", str(folder / "config.yaml"), *alone], shows_bars=False).run(aside)


def keep_known_effects(run: Run) -> None:
    """Write ``effects.yaml`` of a run that begins with effects; what it finds itself is written there as well."""
    if run.worlds.added_effects and not (path := run.folder / "effects.yaml").exists():
        write_yaml(path, [e.to_dict() for e in run.worlds.added_effects])


@contextmanager
def ended(aside: Aside) -> Iterator[None]:
    """Leave no process behind."""
    try:
        yield
    finally:
        if isinstance(aside, OtherProcesses):
            aside.close()


def main(args: list[str]) -> int:
    """Run ``idapt fit``."""
    cli = GroundingCLI([current(a) for a in resumed_in_place(args)])
    if cli.config.seed_everything is not False:
        raise ValueError(f"seed_everything: {cli.config.seed_everything} has no effect here; the root seed is --seed")
    run = cli.run()
    method = run.method  # settings that contradict each other end it here, where nothing is written yet
    with (
        claim(run.folder), resumable(run.folder, "idapt fit", "stages"), ended(run.aside), keeping_warnings(run.folder),
    ):  # fmt: skip
        write_provenance(cli.parser, cli.config, run.folder, cli.shortened_by)
        keep_known_effects(run)
        beside = isinstance(run.aside, OtherProcesses)
        if run.config.method == "idapt":
            run.context.stages.time_left = TimeLeft(expected_seconds(run.config, beside))
        run.restore_ledger()
        run.worlds.look_for_target(run.recorded)
        if told := run.worlds.views_apart:
            log.warning("%s", told)
        evaluations = method.run()
        summary = run.evaluation.summary(evaluations)
        if run.config.oracle:
            train_oracle(run.grounding)
            summary = run.evaluation.summary(evaluations)
        print_summary(summary, run.folder, write_run_report(run))
    return 0
