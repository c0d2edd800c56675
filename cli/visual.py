"""``idapt visual``: the visual transformation on its own, between any two sets of images; see docs/guide/images.md."""

from __future__ import annotations

import logging
import shlex
import sys
import warnings
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from cli import visual_export
from cli.interrupt import resumable
from cli.provenance import claim, write_provenance
from cli.run_folder import resumed_in_place
from cli.visual_quality import TranslationQuality
from cli.visual_writer import TranslationWriter
from datamodules.atomic import remove_stale
from datamodules.images import ImageDomains
from idapt_pl.checkpoints import read_checkpoint
from idapt_pl.health import Health, check_weights
from idapt_pl.modules import VisualTransformation
from idapt_pl.modules.manual import computes_bfloat16
from idapt_pl.modules.ranges import MODULE_RANGES
from idapt_pl.modules.state_predictor import fit_state_predictor
from idapt_pl.nets.encoder import Vision
from idapt_pl.ranges import COUNT, COUNT_OR_NONE, POSITIVE, check_ranges

log = logging.getLogger(__name__)

DESCRIPTION = f"{__doc__} `idapt visual export --help`: G as one file for deployment."
DIMENSIONS = {"state_dim", "image_size", "frame_stack", "rates", "dt", "vision", "bf16"}
"""Constructor arguments that data, checkpoint or Trainer determine (precision is the Trainer's)."""


@dataclass(frozen=True)
class Labelled:
    """How P^S is fitted before G, where source images have labels.

    Args:
        batches: gradient steps.
        batch_size: labelled images (stacks) in each.
        lr: Adam's first learning rate; it is annealed to zero.
    """

    batches: int = 2000
    batch_size: int = 32
    lr: float = 1e-3

    def __post_init__(self) -> None:
        check_ranges("labelled", vars(self), {"batches": COUNT_OR_NONE, "batch_size": COUNT, "lr": POSITIVE})


class SeedEpochs(L.Callback):
    """Seeds every epoch on its own, so that a run that was interrupted goes on as if it had not been."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def on_train_epoch_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        torch.manual_seed((self.seed * 1_000_003 + trainer.current_epoch) * 1009 + trainer.global_rank)


class VisualCLI(LightningCLI):
    """A LightningCLI on VisualTransformation and ImageDomains.

    The data determine what a new model looks like; after ``fit``, the checkpoint does.
    """

    def __init__(self, args: list[str]) -> None:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "LightningCLI's args parameter")  # DDP starts its processes from sys.argv
            super().__init__(
                VisualTransformation,
                ImageDomains,
                args=args,
                save_config_callback=None,
                auto_configure_optimizers=False,
                seed_everything_default=0,
                trainer_defaults={
                    "max_epochs": 200,
                    "log_every_n_steps": 10,
                    "enable_model_summary": False,
                    "num_sanity_val_steps": 0,
                },
                parser_kwargs={
                    "prog": "idapt visual",
                    "description": DESCRIPTION,
                    "exit_on_error": False,
                    "allow_abbrev": False,
                },
            )

    def add_core_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        parser.add_argument("--run_dir", type=str, default="runs/visual", help="folder for checkpoint, config and logs")
        parser.add_class_arguments(VisualTransformation, "model", skip=DIMENSIONS, instantiate=False)
        parser.add_class_arguments(Vision, "vision")
        parser.add_class_arguments(Labelled, "labelled")
        parser.add_lightning_class_args(ImageDomains, "data")
        parser.add_lightning_class_args(TranslationQuality, "quality")
        parser.add_lightning_class_args(TranslationWriter, "predictions")
        parser.add_lightning_class_args(L.Trainer, "trainer")
        parser.set_defaults({f"trainer.{k}": v for k, v in self.trainer_defaults.items()})

    def _parse_ckpt_path(self) -> None:
        """Nothing here: :meth:`instantiate_classes` makes the whole model from the checkpoint."""

    def instantiate_classes(self) -> None:
        self.config_init = self.parser.instantiate_classes(self.config)
        self.options = self.config_init[self.subcommand]
        self.run_dir = Path(self.options.run_dir)
        self.datamodule = self.options.data
        self.trainer = self.instantiate_trainer()
        self.model = self.new_model() if self.subcommand == "fit" else self.trained_model()

    def new_model(self) -> VisualTransformation:
        """A model for the data; with labels, around a P^S that is fitted to them first."""
        o, dimensions = self.options, self.datamodule.dimensions
        check_ranges("model", o.model.as_dict(), MODULE_RANGES["visual"])
        model = VisualTransformation(**o.model.as_dict(), vision=o.vision, bf16=False, **dimensions)
        self.resume()
        if model.P_T is not None and not o.ckpt_path:
            device = self.trainer.strategy.root_device
            source = self.datamodule.load("source")
            P_S = o.vision.predictor(
                dimensions["image_size"], dimensions["frame_stack"], source.labels.shape[1], {}, 1.0
            )
            P_S = fit_state_predictor(P_S, source, **vars(o.labelled), device=device)
            check_weights(P_S, "visual fit, P^S", "Look at labelled.lr")
            model.adopt(P_S)
        elif model.P_T is not None:
            model.adopt(model.P_T)
        return model

    def resume(self) -> None:
        """Note the config in the run folder, and go on from the folder's checkpoint if it has one.

        Raises:
            ValueError: if the folder holds a run with another config.
        """
        if self.run_dir.is_dir():
            remove_stale(self.run_dir)
        write_provenance(self._parser("fit"), self.config["fit"], self.run_dir)
        last = self.run_dir / "last.ckpt"
        if self.options.ckpt_path is None and last.exists():
            read_checkpoint(last, "Delete it, and the same command begins anew.")  # the Trainer would not look
            self.options.ckpt_path = str(last)
            log.info("going on from %s", last)
        if self.options.ckpt_path is not None:
            VisualTransformation.from_checkpoint(Path(self.options.ckpt_path))  # says what is wrong with it
        self.options.weights_only = True

    def trained_model(self) -> VisualTransformation:
        """The model of a checkpoint, by default this run folder's."""
        path = Path(self.options.ckpt_path or self.run_dir / "last.ckpt")
        self.options.ckpt_path = None  # loaded here, not by the Trainer
        return VisualTransformation.from_checkpoint(path)

    def instantiate_trainer(self, **kwargs: Any) -> L.Trainer:
        """The Trainer of the config, logging to the run folder and keeping its last checkpoint."""
        config = self.options.trainer
        if config.logger in (None, True):
            kinds = {"fit": (TensorBoardLogger, CSVLogger), "predict": ()}.get(self.subcommand, (TensorBoardLogger,))
            kwargs["logger"] = [make(self.run_dir, name="", version="") for make in kinds]
        if self.subcommand == "fit":
            # Not save_last: without others to be the last of, it is written when training has ended.
            keep = ModelCheckpoint(self.run_dir, filename="last", save_top_k=1, enable_version_counter=False)
            self.health = Health("visual fit", "model")
            seeds = SeedEpochs(int(self.options.seed_everything))
            kwargs["callbacks"] = [*(config.callbacks or []), seeds, self.health, keep]
        if config.precision is None:
            on_gpu = config.accelerator in ("auto", "gpu", "cuda") and torch.cuda.is_available()
            kwargs["precision"] = "bf16-mixed" if computes_bfloat16("cuda" if on_gpu else "cpu") else "32-true"
        if config.strategy in ("auto", "ddp"):
            kwargs["strategy"] = strategy(config.accelerator, config.devices, int(config.num_nodes))
        kwargs["default_root_dir"] = str(self.run_dir)
        kwargs["enable_progress_bar"] = sys.stderr.isatty() and config.enable_progress_bar is not False
        return super().instantiate_trainer(**kwargs)

    def fit(self, **arguments: Any) -> None:
        """Train, and say what is kept where that is interrupted."""
        if self.trainer.is_global_zero:
            log.info(
                "G of %d source and %d target images, %s epochs on %s; watch it with: tensorboard --logdir %s",
                *(len(self.datamodule.load(of)) for of in ("source", "target")),
                self.trainer.max_epochs,
                self.trainer.strategy.root_device,
                shlex.quote(str(self.run_dir)),
            )
        alone = claim(self.run_dir) if self.trainer.is_global_zero else nullcontext()
        with alone, resumable(self.run_dir, "idapt visual fit", "epochs", "last.ckpt"):
            metrics = self.run_dir / "metrics.csv"
            if metrics.exists() and self.trainer.is_global_zero:  # CSVLogger begins the file anew
                metrics.rename(self.run_dir / f"metrics_{len(list(self.run_dir.glob('metrics_*.csv')))}.csv")
            with self.health.explaining(self.model):
                self.trainer.fit(**arguments)
        self.health.running_away(self.model, self.datamodule)
        if self.trainer.is_global_zero:
            log.info("%d epochs done -> %s", self.trainer.current_epoch, self.run_dir / "last.ckpt")
            if not self.datamodule.has_tests:
                log.info("how good G is was not measured: --data.test_source and --data.test_target give figures")


def strategy(accelerator: str, devices: str | int | list[int], nodes: int) -> str:
    """How to train on so many devices: G and D are trained in turn, and DDP must be told that some nets rest.

    Args:
        accelerator: as the Trainer takes it.
        devices: number, list or ``"auto"``, as the Trainer takes it.
        nodes: machines.
    """
    if devices == "auto":
        count = torch.cuda.device_count() if accelerator in ("auto", "gpu", "cuda") else 1
    else:
        count = len(devices) if isinstance(devices, list) else int(devices)
        count = torch.cuda.device_count() if count == -1 else count
    return "ddp_find_unused_parameters_true" if count * nodes > 1 else "auto"


def main(args: list[str]) -> int:
    """Run ``idapt visual fit|validate|test|predict|export``."""
    if args[:1] == ["export"]:
        return visual_export.main(args[1:])
    VisualCLI(resumed_in_place(args))
    return 0
