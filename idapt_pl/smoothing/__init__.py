"""States of recordings that show images alone: what a sensor reads, held together by a model's physics and actions."""

from idapt_pl.smoothing.ensemble import SimulatedEnsemble
from idapt_pl.smoothing.fixed_lag import EnsembleFilter, ReadingModel, Smoothed, smooth_episode
from idapt_pl.smoothing.offsets import reading_offsets
from idapt_pl.smoothing.recordings import (
    ReadRecording,
    RecordingSmoother,
    most_that_is_bearable,
    reading_model,
)

__all__ = [
    "EnsembleFilter",
    "ReadRecording",
    "ReadingModel",
    "RecordingSmoother",
    "SimulatedEnsemble",
    "Smoothed",
    "most_that_is_bearable",
    "reading_model",
    "reading_offsets",
    "smooth_episode",
]
