"""Argument parsers whose help is the docstring and whose errors exit with 2."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

import yaml

from datamodules.safe_yaml import DataLoader


class Help(argparse.ArgumentDefaultsHelpFormatter):
    """Shows defaults, but not that there is none."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        return action.help if action.default is None else super()._get_help_string(action)


class HelpWithExamples(Help, argparse.RawDescriptionHelpFormatter):
    """Leaves the lines of the description and the examples as they are."""


class SuggestingParser(argparse.ArgumentParser):
    """Says which option may have been meant."""

    def error(self, message: str) -> NoReturn:
        found = re.fullmatch(r"unrecognized arguments: (--[\w-]+).*", message)
        if found and (near := get_close_matches(found[1], list(self._option_string_actions), 1)):
            message += f"; did you mean {near[0]}?"
        super().error(message)


def parser(command: str, description: str, examples: str = "") -> argparse.ArgumentParser:
    """A parser for ``idapt <command>`` that shows defaults.

    Args:
        command: its name.
        description: what it does.
        examples: shown at the end; with them, lines stay as they are written.
    """
    return SuggestingParser(
        prog=f"idapt {command}",
        description=description,
        epilog=examples,
        formatter_class=HelpWithExamples if examples else Help,
    )


def add_task_options(p: argparse.ArgumentParser) -> None:
    """Give a parser ``--task_options``, spelled as in `idapt fit`, or with a hyphen as this command's other options."""
    p.add_argument(
        "--task_options",
        "--task-options",
        type=options_of,
        default={},
        metavar="YAML",
        help="of a task that is none of the five, as in a config: '{action_repeat: 4}'",
    )


def options_of(text: str) -> dict[str, Any]:
    """Keys and values that are given in an argument.

    Raises:
        ArgumentTypeError: if it is something else.
    """
    try:
        found = yaml.load(text, DataLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise argparse.ArgumentTypeError(f"no YAML: {' '.join(str(error).split())[:200]}") from None
    if not isinstance(found, dict) or not all(isinstance(key, str) for key in found):
        raise argparse.ArgumentTypeError(f"expected keys and values such as '{{action_repeat: 4}}', got {text[:80]!r}")
    return found


def keep_inputs(out: Path, inputs: Iterable[Path | str | None]) -> None:
    """Refuse to write over what is read.

    Args:
        out: what is to be written.
        inputs: what is read; None where an option was not given.

    Raises:
        ValueError: naming the file.
    """
    for path in (Path(p) for p in inputs if p is not None):
        if out.resolve() == path.resolve() or (out.exists() and path.exists() and out.samefile(path)):
            raise ValueError(f"{out}: --out is also read from; name another file")


def show_bar() -> bool:
    """Whether a progress bar makes sense: only where a person watches."""
    return sys.stderr.isatty()
