"""Worlds as MJCF models plus effects, and images of them."""

from idapt_pl.domains import looks, paths  # registers the effects on images, commands, forces and sensing
from idapt_pl.domains.domain import WHOLE, Domain, View
from idapt_pl.domains.effects import EFFECTS, Effect, effect_from_dict

__all__ = ["EFFECTS", "WHOLE", "Domain", "Effect", "View", "effect_from_dict", "looks", "paths"]
