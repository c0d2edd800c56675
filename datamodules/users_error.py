"""Errors whose messages have several lines that must stay as they are."""

from __future__ import annotations


class WholeError(ValueError):
    """A message that is shown whole.

    Attributes:
        exit_code: of the command that it ends.
    """

    exit_code = 1


class UsersError(WholeError):
    """A module of the user's failed; the message has its error, as Python shows it."""
