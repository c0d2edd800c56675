"""Closing the loop with measured states: residual, cause, repaired model."""

from idapt_pl.diagnosis.search import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]
