"""Argument parsers whose help is the docstring and whose errors exit with 2."""

from __future__ import annotations

import argparse
import sys


def parser(command: str, description: str) -> argparse.ArgumentParser:
    """A parser for ``idapt <command>`` that shows defaults."""
    return argparse.ArgumentParser(
        prog=f"idapt {command}", description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )


def show_bar() -> bool:
    """Whether a progress bar makes sense: only where a person watches."""
    return sys.stderr.isatty()
