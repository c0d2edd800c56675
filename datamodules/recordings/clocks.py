"""Whether the clocks of topics belong together: where they do not overlap, and where one falls silent.

A held value is the rule for commands that are sent when they change. A stream that stops is another thing: nobody knows
what came after it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from datamodules.recordings.errors import RecordingError

NS = 1e-9
STREAM = 10
"""A topic of fewer messages is no stream: its last message is held, as that of a target that was sent once."""
SILENT_PAUSES, SILENT_SHARE = 10, 0.05
"""A stream stopped if it is silent for more than so many of its longest pauses, and such a share of the recording."""


def end_of_rows(path: object, clock: str, times: Mapping[str, np.ndarray]) -> tuple[int | None, tuple[str, ...]]:
    """After which time there are no rows, since a topic stopped; and what to tell of the clocks.

    Args:
        path: of the log, for messages.
        clock: the topic whose messages are the rows.
        times: log times (messages,) of every topic, increasing, ns.

    Returns:
        The time of the last row, ns, or None where all are wanted; notes.

    Raises:
        RecordingError: naming a topic none of whose messages can belong to a row, and by how much it is off.
    """
    first, last = int(times[clock][0]), int(times[clock][-1])
    end, notes = None, []
    for name, own in times.items():
        if name == clock or not len(own):
            continue
        _check_overlap(path, clock, (first, last), name, own)
        late, silent = int(own[0]) - first, last - int(own[-1])
        if late > SILENT_SHARE * (last - first):
            notes.append(f"topic {name} begins {late * NS:.3g} s after {clock}: rows before it are left out")
        pause = int(np.diff(own).max(initial=0))
        if silent <= max(pause, SILENT_SHARE * (last - first)):
            continue
        after = f"topic {name} ends {silent * NS:.3g} s before {clock}"
        if len(own) >= STREAM and silent > SILENT_PAUSES * pause:
            end = min(int(own[-1]) + pause, last if end is None else end)
            notes.append(f"{after}, and never paused for more than {pause * NS:.3g} s: rows after it are left out")
        elif len(own) > 1:
            notes.append(f"{after}: its last message is held until there")
    return end, tuple(f"{path}: {note}" for note in notes)


def _check_overlap(path: object, clock: str, span: tuple[int, int], name: str, own: np.ndarray) -> None:
    """Refuse a topic that begins after the rows end, or ended before they begin; one single message may come early.

    That single message is held, as a target or a mode is, if it is no further away than the recording is long.
    """
    first, last = span
    after, before = int(own[0]) - last, first - int(own[-1])
    early = before > (0 if len(own) > 1 else last - first)
    if after <= 0 and not early:
        return
    told = f"begins {after * NS:.6g} s after {clock} ends" if after > 0 else f"ends {before * NS:.6g} s before {clock}"
    raise RecordingError(
        f"{path}: the clocks of its topics do not match: {name} {told}{'' if after > 0 else ' begins'} (log times "
        f"{own[0]} to {own[-1]} ns, and {first} to {last} ns); record both at once, or put right the clock of the "
        "machine that was off"
    )
