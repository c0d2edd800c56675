"""Worlds as MJCF models plus effects, and images of them."""

from idapt_pl.domains.domain import Domain
from idapt_pl.domains.effects import EFFECTS, Effect, effect_from_dict

__all__ = ["EFFECTS", "Domain", "Effect", "effect_from_dict"]
