"""Stretches of recordings in which a model cannot hold: a push, a catch, a change of support, motors off.

They are given by the user (:mod:`~idapt_pl.stretches.conditions`) or found from the recordings
(:mod:`~idapt_pl.stretches.find`), and left out of a diagnosis
(:func:`~idapt_pl.stretches.diagnose.diagnose_stretches`).
"""

from idapt_pl.stretches.conditions import mark_by_conditions
from idapt_pl.stretches.diagnose import diagnose_stretches
from idapt_pl.stretches.stretch import Stretch, StretchReport

__all__ = ["Stretch", "StretchReport", "diagnose_stretches", "mark_by_conditions"]
