"""Which visual effects does the model lack? Found by rendering what episodes begin with."""

from idapt_pl.appearance.discovery import discover_visual_effects
from idapt_pl.appearance.result import VisualEffects
from idapt_pl.appearance.search import find_visual_effects

__all__ = ["VisualEffects", "discover_visual_effects", "find_visual_effects"]
