"""What a package offers, loaded when somebody asks for it (PEP 562): torch takes seconds, and much does without."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any


def on_demand(package: str, modules: dict[str, str]) -> Callable[[str], Any]:
    """A package's ``__getattr__``, which loads the module that a name is in when somebody asks for the name.

    Args:
        package: its full name.
        modules: names of its modules, and after each what of it the package has, with spaces between.
    """
    where = {name: module for module, names in modules.items() for name in names.split()}

    def of_module(name: str) -> Any:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(f"{package}.{where[name]}"), name)

    return of_module
