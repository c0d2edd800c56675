"""Errors of the user's own code, shown as Python shows them."""

from __future__ import annotations

import traceback


def whole(message: str) -> str:
    """A message with the error that is being handled, as Python shows it."""
    return f"{message}:\n{traceback.format_exc().rstrip()}"
