"""Trainers for stages: each fits once, for as many batches as the stage says."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import lightning as L
from lightning.pytorch.loggers import CSVLogger


def stage_settings(folder: Path, batches: int) -> dict[str, Any]:
    """What every stage's Trainer is told; the rest is the user's."""
    return {
        "default_root_dir": str(folder),
        "max_epochs": 1,
        "limit_train_batches": batches,
        "log_every_n_steps": max(1, batches // 250),
        "enable_progress_bar": sys.stderr.isatty(),
        "enable_checkpointing": False,
        "enable_model_summary": False,
    }


def plain_trainer(folder: Path, batches: int) -> L.Trainer:
    """A Trainer for small nets, outside a run of Algorithm 1: on the CPU, metrics to a CSV file."""
    logger = CSVLogger(folder, name="", version="")
    return L.Trainer(accelerator="cpu", logger=logger, **stage_settings(folder, batches))
