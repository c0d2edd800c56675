"""A policy on its way to a robot: one file, and a program that plays it."""

from idapt_pl.deployment.onnx_policy import open_session, played_by_file
from idapt_pl.deployment.write import TOLERANCE, largest_difference, write_play, write_policy

__all__ = ["TOLERANCE", "largest_difference", "open_session", "played_by_file", "write_play", "write_policy"]
