"""An error in a module of the user's."""

from __future__ import annotations


class UsersError(ValueError):
    """A module of the user's failed; the message has its error whole, as Python shows it."""
