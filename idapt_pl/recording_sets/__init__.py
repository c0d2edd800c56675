"""Several recordings of one robot: the common answer, and which of its values differ between files.

:func:`~idapt_pl.recording_sets.join.join_recordings` puts files together,
:func:`~idapt_pl.recording_sets.compare.compare_sets` fits what was found to each of them alone.
"""

from idapt_pl.recording_sets.compare import compare_sets
from idapt_pl.recording_sets.join import RecordingSet, join_recordings
from idapt_pl.recording_sets.result import SetComparison

__all__ = ["RecordingSet", "SetComparison", "compare_sets", "join_recordings"]
