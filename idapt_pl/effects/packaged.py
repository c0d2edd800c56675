"""Models and meshes that other packages ship. Their files are used, their Python is not imported."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path


class ModelsMissing(RuntimeError):
    """A package whose models a task is built on is not installed; the message says how to get it."""


def packaged_file(package: str, file: str) -> Path:
    """A file of an installed package, by the end of its path.

    Raises:
        ModelsMissing: if the package, or the file in it, is not there.
    """
    try:
        files = importlib.metadata.files(package) or []
    except importlib.metadata.PackageNotFoundError:
        raise ModelsMissing(
            f"this task is built on the models and meshes of the package {package}, which is not installed: "
            "pip install 'idapt[manipulation]'"
        ) from None
    for path in files:
        if str(path).endswith(file):
            return Path(str(path.locate()))
    version = importlib.metadata.version(package)
    raise ModelsMissing(
        f"{package} {version} has no file {file}; install the version that idapt[manipulation] asks for"
    )
