"""The configs that come with the package, so that ``configs/pendulum_quick.yaml`` can be given in any folder."""

from __future__ import annotations

from pathlib import Path

ABOVE = Path(__file__).parents[2]
"""Where the folder ``configs`` is, beside the packages: in a clone as in an installed wheel."""


def config_path(told: str | Path) -> Path:
    """A config by its name: the file of that name from here if there is one, or else that of the package.

    Args:
        told: its name, or text that is none.

    Returns:
        The file; ``told`` where there is neither.
    """
    shipped = ABOVE / told
    if not is_file(Path(told)) and Path(told).parts[:1] == ("configs",) and is_file(shipped):
        return shipped
    return Path(told)


def is_file(path: Path) -> bool:
    """Whether this is a file; an option may also be given as text, which can be no name at all."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def with_shipped_configs(args: list[str]) -> list[str]:
    """Arguments of a command, in which configs that only the package has are given by their place."""
    named = ("-c", "--config")
    out = []
    for before, argument in zip(["", *args], args, strict=False):
        option, equals, value = argument.partition("=")
        if before in named:
            argument = placed(argument)
        elif equals and option in named:
            argument = f"{option}={placed(value)}"
        out.append(argument)
    return out


def placed(value: str) -> str:
    """The name of a config that is there; other values as they are."""
    return value if "\n" in value or not value.startswith("configs") else str(config_path(value))
