"""Checkpoints: weights and numbers alone, read without unpickling code, and not before they are known to be whole."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import torch

from idapt_pl.files import REDO, blaming, verify


def checkpoint_bytes(module: torch.nn.Module) -> bytes:
    """A checkpoint of a LightningModule: weights and constructor arguments, the same bytes for the same ones."""
    buffer = io.BytesIO()
    torch.save({"state_dict": module.state_dict(), "hyper_parameters": dict(module.hparams)}, buffer)
    return buffer.getvalue()


def read_checkpoint(path: Path, cure: str = REDO) -> Any:
    """What a checkpoint holds, on the CPU.

    It is compared with the SHA-256 that its stage noted, and with the checksums that the file itself has.

    Raises:
        DamagedFile: if it is missing, damaged or no checkpoint.
    """
    with blaming(path, cure):
        verify(path)
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                if damaged := archive.testzip():  # torch itself does not look
                    raise ValueError(f"{damaged} in it is damaged")
        return torch.load(path, weights_only=True, map_location="cpu")


def load_weights(module: torch.nn.Module, path: Path, cure: str = REDO) -> None:
    """Give a module the weights of a checkpoint.

    Raises:
        DamagedFile: as of :func:`read_checkpoint`, or if they are another module's.
    """
    with blaming(path, cure):
        module.load_state_dict(read_checkpoint(path, cure)["state_dict"])
