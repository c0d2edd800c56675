"""Modules loaded only where they are used, and what is then to be done: torch takes seconds, and much does without."""

from __future__ import annotations

import importlib
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

_WAITING: dict[str, list[Callable[[], object]]] = defaultdict(list)
"""By the module that is waited for."""


def once_loaded(module: str, do: Callable[[], object]) -> None:
    """Do something right after a module is imported, before whoever imports it goes on; at once if it is there already.

    Args:
        module: its full name.
        do: called once, in the order of these calls.
    """
    if module in sys.modules:
        do()
    else:
        _WAITING[module].append(do)


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


class _Finder(MetaPathFinder):
    """Leaves finding to the others, and sees to it that loading what is waited for ends with what waits."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name not in _WAITING:
            return None
        found = (finder.find_spec(name, path, target) for finder in sys.meta_path if finder is not self)
        spec = next((s for s in found if s is not None), None)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_do(module: ModuleType) -> None:
                load(module)
                for do in _WAITING.pop(name, []):
                    do()

            spec.loader.exec_module = load_and_do  # type: ignore[method-assign]
        return spec


sys.meta_path.insert(0, _Finder())
