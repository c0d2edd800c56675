"""Effects: named, typed edits of an MJCF model, and domains, which are a model and a list of them."""

import importlib
import pkgutil

from idapt_pl.effects.base import EFFECTS, Effect, effect_from_dict
from idapt_pl.effects.domain import WHOLE, Domain, View

__all__ = ["EFFECTS", "WHOLE", "Domain", "Effect", "View", "effect_from_dict"]

for _file in pkgutil.iter_modules(__path__):  # every file here is loaded, and with it the effects that it defines
    importlib.import_module(f"{__name__}.{_file.name}")
