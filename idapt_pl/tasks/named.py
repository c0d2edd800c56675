"""What a config names by ``module:name``: found, checked, and only then called, as configs come from anywhere."""

from __future__ import annotations

import importlib
import inspect
import os
import sys
import types
import typing
from pathlib import Path
from typing import Any

from datamodules.users_error import UsersError
from idapt_pl.tasks.users_code import whole


def make_named(path: str, kind: type, what: str, options: dict[str, Any]) -> Any:
    """What a class or function of the user's makes.

    Args:
        path: ``module:name``.
        kind: class that is wanted, such as Task.
        what: it is to be, for messages.
        options: of the class or function.

    Raises:
        UsersError: if the user's code fails, whose error is shown whole.
        ValueError: if there is no such thing, or it says not that it makes one; then it was not called.
    """
    found = find_named(path, kind, what)
    return found if isinstance(found, kind) else call_users(found, f"{what} {path}", options)


def find_named(path: str, kind: type, what: str) -> Any:
    """An instance of a class, a subclass of it, or a function that is annotated to return one.

    Anything else could be called too, and could do anything: a run folder may be somebody else's.

    Raises:
        UsersError: if its module fails, whose error is shown whole.
        ValueError: if there is none.
    """
    found = import_from(path, what)
    if isinstance(found, kind) or (isinstance(found, type) and issubclass(found, kind)):
        return found
    wanted = f"{kind.__module__.rpartition('.')[0]}.{kind.__name__}"
    if not (inspect.isfunction(found) or inspect.ismethod(found)):
        its = f"the class {found.__name__}" if isinstance(found, type) else type(found).__name__
        raise ValueError(
            f"{what} {path} is {its}, no {wanted}. Give a subclass of it, or a function that returns one "
            "(docs/guide/own_robot.md)"
        )
    returned = what_returns(found)
    if not (isinstance(returned, type) and issubclass(returned, kind)):
        raise ValueError(
            f"{what} {path} is a function that is not said to return {wanted}, so it is not called. If it does, "
            f"write `def {found.__name__}(...) -> {kind.__name__}:`"
        )
    return found


def what_returns(function: Any) -> Any:
    """The class that a function is annotated to return, also where that is written as text; None if it says none."""
    said = types.SimpleNamespace(__annotations__={"return": function.__annotations__.get("return")})
    try:
        told = typing.get_type_hints(said, globalns=function.__globals__)["return"]
    except Exception:  # a name that only type checkers know
        return None
    return typing.get_origin(told) or told


def import_from(path: str, what: str) -> Any:
    """What ``module:name`` names; modules are looked for in the current folder too.

    Args:
        path: ``module:name``.
        what: it is to be, for messages.

    Raises:
        UsersError: if the module fails, whose error is shown whole.
        ValueError: if there is no such thing.
    """
    module_name, _, attribute = path.partition(":")
    if not module_name or not attribute:
        raise ValueError(f"{what} {path!r} is no import path; give MODULE:NAME, such as my_robot.task:Reach")
    refuse_pythons_own(module_name, f"{what} {path}")
    look_here_too()
    try:
        found = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not (module_name + ".").startswith(error.name + "."):
            raise UsersError(whole(f"{what} {path}: its module fails")) from None
        raise ValueError(f"{what} {path}: there is no module {error.name!r} {where_looked()}") from None
    except Exception:
        raise UsersError(whole(f"{what} {path}: its module fails")) from None
    for part in attribute.split("."):
        if not hasattr(found, part):
            names = [name for name in vars(found) if not name.startswith("_")]
            raise ValueError(f"{what} {path}: {found.__name__} has no {part!r}; it has: {', '.join(names)}")
        found = getattr(found, part)
    return found


def refuse_pythons_own(module: str, what: str) -> None:
    """Python's own modules have no robots; some do things when they are imported.

    Raises:
        ValueError: if it is one of them.
    """
    if module.partition(".")[0] in sys.stdlib_module_names:
        raise ValueError(
            f"{what}: {module} is a module of Python itself, and nothing of it is imported or called here. Name a "
            "module of yours, and not as one of Python's"
        )


def look_here_too() -> None:
    """Let modules be found in the current folder, as `python -m` does; but not in a run folder."""
    here = os.getcwd()
    if run_folder_around(Path(here)):
        sys.path[:] = [p for p in sys.path if p not in ("", here)]
    elif here not in sys.path:
        sys.path.insert(0, here)


def where_looked() -> str:
    """Where modules were looked for, in words."""
    here = Path.cwd()
    if run := run_folder_around(here):
        return (
            f"among the installed packages, and {here} is not looked into: it is in the run folder {run}, from which "
            "nothing is executed. Give the command in the folder of your module"
        )
    return f"in {here} or among the installed packages"


def run_folder_around(folder: Path) -> Path | None:
    """The run folder that a folder lies in, or is; None if there is none."""
    around = (f for f in (folder, *folder.parents) if (f / "run.json").exists() and (f / "config.yaml").exists())
    return next(around, None)


def call_users(made: Any, what: str, options: dict[str, Any]) -> Any:
    """What a user's class or function gives.

    Raises:
        UsersError: if it fails; its error is shown whole.
        ValueError: if it is this package's, such as the client of a robot's server; its message says enough.
    """
    try:
        return made(**options)
    except Exception as error:
        if str(getattr(made, "__module__", "")).startswith("idapt_pl."):
            raise ValueError(f"{what}: {error}") from error
        raise UsersError(whole(f"{what} fails")) from None
