"""Recordings of a robot in the formats that labs keep them in, turned into trajectory files (docs/guide/import.md)."""

from datamodules.recordings.check import ActuatorLayout, JointLayout, ModelLayout, fit_to_model
from datamodules.recordings.convert import Imported, convert
from datamodules.recordings.draft import Draft, draft_map
from datamodules.recordings.draft_text import write_draft
from datamodules.recordings.errors import RecordingError
from datamodules.recordings.formats import FORMATS, read_recording
from datamodules.recordings.mapping import Mapping, parse_mapping, read_mapping
from datamodules.recordings.preview import Row, summary
from datamodules.recordings.resample import resampled

__all__ = [
    "FORMATS",
    "ActuatorLayout",
    "Draft",
    "Imported",
    "JointLayout",
    "Mapping",
    "ModelLayout",
    "RecordingError",
    "Row",
    "convert",
    "draft_map",
    "fit_to_model",
    "parse_mapping",
    "read_mapping",
    "read_recording",
    "resampled",
    "summary",
    "write_draft",
]
