"""Which visual effects does the model lack? Found by rendering what episodes begin with."""

from idapt_pl.appearance.discovery import discover_looks
from idapt_pl.appearance.search import Looks, find_looks

__all__ = ["Looks", "discover_looks", "find_looks"]
