"""``idapt fit``: Algorithm 1 as a LightningCLI application."""

from __future__ import annotations

import functools
import sys
from pathlib import Path

import lightning as L
import numpy as np
from jsonargparse import Namespace
from lightning.pytorch.callbacks import TQDMProgressBar
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from cli.provenance import claim, write_provenance
from cli.table import print_summary
from cli.trainers import stage_settings
from idapt_pl.baselines.oracle import train_oracle
from idapt_pl.effects import View
from idapt_pl.envs.ledger import Ledger
from idapt_pl.evaluation.evaluation import Evaluation
from idapt_pl.grounding import IterativeGrounding, Schedule
from idapt_pl.image_diagnosis.settings import DiscoverySettings
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, StatePredictor, VisualTransformation
from idapt_pl.nets.encoder import Vision
from idapt_pl.rendering.parallel import usual_processes
from idapt_pl.report.run_page import write_run_report
from idapt_pl.stage import Stages
from idapt_pl.stages.distillation import TeacherSettings
from idapt_pl.stages.fitting import Fitting
from idapt_pl.stages.settings import BatchSettings, ModuleFactories
from idapt_pl.tasks import TASKS, make_task
from idapt_pl.worlds import Worlds

DIMENSIONS = {"state_dim", "image_size", "frame_stack", "action_low", "action_high", "rates", "dt", "vision"}
"""Constructor arguments that the task and the data determine, never typed in a config."""

MODULES: dict[str, type[L.LightningModule]] = {
    "state_predictor": StatePredictor,
    "visual": VisualTransformation,
    "dynamics": ActionTransformation,
    "policy": AsymmetricSAC,
}


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

    def __init__(self, args: list[str] | Namespace) -> None:
        sys.argv = ["idapt fit"]  # LightningCLI warns when it is given arguments beside the process's own
        super().__init__(
            args=args,
            run=False,
            save_config_callback=None,
            auto_configure_optimizers=False,
            seed_everything_default=False,
            parser_kwargs={"prog": "idapt fit", "description": __doc__, "exit_on_error": False},
        )

    def add_core_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        parser.add_argument("--seed", type=int, default=0, help="root seed; every stage derives its own")
        parser.add_argument("--run_dir", type=str, default=None, help="run folder; default runs/<task>_<target>_<seed>")
        parser.add_argument("--task", type=str, default="inverted_pendulum", help=f"one of: {', '.join(TASKS)}")
        parser.add_argument("--target", type=str, default="hard", help="target domain: easy or hard")
        parser.add_argument("--image_size", type=int, default=100, help="side of the rendered images, pixels")
        parser.add_argument(
            "--render_processes",
            type=int | None,
            default=None,
            help="further processes that render where several simulations run side by side; default one for each core "
            "but one, at most 3. Images do not depend on it",
        )
        parser.add_class_arguments(View, "view")
        parser.add_argument("--frame_stack", type=int, default=3, help="frames in an observation")
        parser.add_argument("--episodes", type=int, default=20, help="episodes for each reported return")
        parser.add_argument("--oracle", type=bool, default=False, help="also train the oracle reference in the target")
        parser.add_class_arguments(Schedule, "schedule")
        parser.add_class_arguments(DiscoverySettings, "effects")
        parser.add_class_arguments(BatchSettings, "feeding")
        parser.add_class_arguments(TeacherSettings, "teacher")
        parser.add_class_arguments(Vision, "vision")
        for name, module in MODULES.items():
            parser.add_class_arguments(
                module, name, skip=DIMENSIONS | ({"encoder"} if name == "dynamics" else set()), instantiate=False
            )
        parser.add_lightning_class_args(L.Trainer, "trainer")

    def instantiate_classes(self) -> None:
        self.config_init = self.parser.instantiate_classes(self.config)

    def trainer_for(self, folder: Path, batches: int) -> L.Trainer:
        """A fresh Trainer for one stage; its metrics go to the stage's folder."""
        step, name = folder.parent.name, folder.name
        return self.instantiate_trainer(
            logger=[TensorBoardLogger(folder, name="", version=""), CSVLogger(folder, name="", version="")],
            callbacks=[StageProgressBar(f"{step} {name}")] if sys.stderr.isatty() else [],
            **stage_settings(folder, batches),
        )


def build(cli: GroundingCLI) -> tuple[IterativeGrounding, Path]:
    """The run that a config describes, and its folder."""
    config = cli.config_init
    check_estimator(config)
    task = make_task(config.task)
    run_dir = Path(config.run_dir or f"runs/{config.task}_{config.target}_{config.seed}")
    worlds = Worlds(
        task,
        task.domain("source"),
        task.domain(config.target),
        Ledger(run_dir / "ledger.json"),
        config.image_size,
        config.frame_stack,
        config.view,
        usual_processes() if config.render_processes is None else config.render_processes,
    )
    if config.effects.discover:  # better said before hours of G
        task.motion(np.zeros((1, worlds.dimensions["state_dim"])), 1.0)
    stages = Stages(run_dir, config.seed, cli.trainer_for)
    factories = {name: functools.partial(module, **config[name].as_dict()) for name, module in MODULES.items()}
    for name in ("state_predictor", "visual", "policy"):
        factories[name] = functools.partial(factories[name], vision=config.vision)
    fitting = Fitting(worlds, stages, ModuleFactories(**factories), config.feeding, config.teacher)
    evaluation = Evaluation(worlds, stages, config.episodes, config.target)
    return IterativeGrounding(fitting, evaluation, config.schedule, config.effects), run_dir


def check_estimator(config: Namespace) -> None:
    """Only a supervised encoder can be regressed on states before the policy trains; better said before hours of G."""
    for name in ("pretrain", "finetune"):
        batches = getattr(config.schedule, name).estimator
        if batches and config.policy.encoder != "supervised":
            raise ValueError(
                f"schedule.{name}.estimator is {batches} batches, but policy.encoder is {config.policy.encoder}: "
                "only a supervised encoder is regressed on states. Set one or the other."
            )


def main(args: list[str]) -> int:
    """Run ``idapt fit``."""
    cli = GroundingCLI(args)
    if cli.config.seed_everything is not False:
        raise ValueError(f"seed_everything: {cli.config.seed_everything} has no effect here; the root seed is --seed")
    grounding, run_dir = build(cli)
    with claim(run_dir):
        write_provenance(cli.parser, cli.config, run_dir)
        summary = grounding.run()
        if cli.config.oracle:
            train_oracle(grounding)
            summary = grounding.evaluation.summary(grounding.schedule.grounding_steps)
        print_summary(summary, run_dir, write_run_report(grounding))
    return 0
