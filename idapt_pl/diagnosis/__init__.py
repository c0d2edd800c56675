"""Closing the loop with measured data: residual, cause, repaired model."""

from idapt_pl.diagnosis.search import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]
