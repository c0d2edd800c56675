"""Closing the loop with measured states: residual, cause, repaired model.

:func:`diagnose` is the way in. :mod:`~idapt_pl.diagnosis.search` reads like the algorithm; a
:class:`~idapt_pl.diagnosis.context.SearchContext` is what stays the same throughout it, a
:class:`~idapt_pl.diagnosis.search_state.SearchState` what its steps take and return, and a
:class:`~idapt_pl.diagnosis.result.DiagnosisResult` what comes out.
"""

from idapt_pl.diagnosis.search import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]
