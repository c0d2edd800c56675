"""Closing the loop with images: effects found in what an image sensor reads, and whether to believe them."""

from idapt_pl.image_diagnosis.discover import discover_effects
from idapt_pl.image_diagnosis.known_effects import known_effects
from idapt_pl.image_diagnosis.result import ImageDiagnosis
from idapt_pl.image_diagnosis.settings import DEFAULT_CANDIDATES, DiscoverySettings

__all__ = ["DEFAULT_CANDIDATES", "DiscoverySettings", "ImageDiagnosis", "discover_effects", "known_effects"]
