"""Closing the loop with measured states: residual, cause, repaired model.

:func:`diagnose` is the way in, and :mod:`~idapt_pl.diagnosis.search` reads like the algorithm. What it is made of, each
knowing only those before it:

- ``candidates``: what is tried, how it is fitted, and what became of it;
- ``state``: what stays the same throughout a search (:class:`~idapt_pl.diagnosis.state.context.SearchContext`), and
  where it stands (:class:`~idapt_pl.diagnosis.state.search_state.SearchState`), which its steps take and return;
- ``rounds``: these steps: screen, confirm, accept, look two ahead, revise, measure;
- ``laws``: a law of force where the library of effects ends;
- ``answer``: what comes out (:class:`~idapt_pl.diagnosis.answer.result.DiagnosisResult`).
"""

from idapt_pl.diagnosis.search import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]
