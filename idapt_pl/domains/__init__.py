"""Worlds as MJCF models plus effects, and images of them."""

import idapt_pl.domains.looks  # registers the visual effects
import idapt_pl.domains.paths  # noqa: F401  registers those of commands, forces and sensing
from idapt_pl.domains.domain import Domain, View
from idapt_pl.domains.effects import EFFECTS, Effect, effect_from_dict

__all__ = ["EFFECTS", "Domain", "Effect", "View", "effect_from_dict"]
