"""Domain randomisation: what policies train in when the source is many worlds at once."""

from idapt_pl.randomisation.found import found_intervals
from idapt_pl.randomisation.settings import FOUND, RandomisationSettings

__all__ = ["FOUND", "RandomisationSettings", "found_intervals"]
