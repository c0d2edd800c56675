"""Effects: named, typed edits of an MJCF model, and domains, which are a model and a list of them."""

from idapt_pl.effects import actuators, bodies, contacts, joints, signals, visual, world  # registers their effects
from idapt_pl.effects.base import EFFECTS, Effect, effect_from_dict
from idapt_pl.effects.domain import WHOLE, Domain, View

__all__ = [
    "EFFECTS", "WHOLE", "Domain", "Effect", "View", "actuators", "bodies", "contacts", "effect_from_dict", "joints",
    "signals", "visual", "world",
]  # fmt: skip
