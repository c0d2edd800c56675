"""Effects found in images, and whether to believe them."""

from idapt_pl.discovery.discover import discover
from idapt_pl.discovery.options import CANDIDATES, Discovery

__all__ = ["CANDIDATES", "Discovery", "discover"]
