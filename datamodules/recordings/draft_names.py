"""What a column's name tells for a draft of a map: words, what kind of quantity it is, and its unit."""

from __future__ import annotations

import re

POSITION, VELOCITY, COMMAND, OTHER_KIND = "position", "velocity", "command", "other"

COMMANDED = {
    *("cmd", "command", "commands", "commanded", "des", "desired", "target", "goal", "setpoint", "ref", "reference"),
    *("action", "actions", "clipped"),
}
"""Words of what somebody wanted; they count for more than what it was wanted of."""
MOVING = {
    *("vel", "velocity", "velocities", "qvel", "qd", "dq", "qdot", "dot", "omega", "speed", "speeds", "rate", "rpm"),
    *("dps", "rps", "gyro", "v", "w"),
}
DRIVING = {
    *("tau", "torque", "torques", "effort", "efforts", "current", "pwm", "duty", "volt", "volts", "voltage", "force"),
    *("thrust", "u", "motor", "mnm", "ncm", "nm", "amps", "ma", "mv", "ctrl", "control", "controls"),
}
PLACED = {
    *("pos", "position", "positions", "q", "qpos", "angle", "angles", "theta", "encoder", "enc", "count", "counts"),
    *("tick", "ticks", "deg", "degree", "degrees", "rad", "rads", "radians", "mm", "cm", "x"),
}
NEITHER = {
    *(
        "temp",
        "temperature",
        "battery",
        "supply",
        "bus",
        "status",
        "mode",
        "error",
        "err",
        "id",
        "index",
        "seq",
        "stamp",
    ),
    *("time", "timestamp", "acc", "accel", "acceleration", "reward", "rewards", "done", "gain", "covariance", "frame"),
    *("delta", "variance", "var", "std", "bias", "noise", "dt", "limit", "min", "max", "valid", "flags", "offset"),
}
"""Words of what is no position, velocity or command, whatever else is in the name."""
GENERIC = {"joint", "motor", "actuator", "act", "hinge", "link", "robot", "slide", "drive", "servo", "the"}
"""Words in names of joints and actuators that tell none from another."""

SUBJECT_UNITS = {
    POSITION: {
        **dict.fromkeys(("deg", "degree", "degrees"), "deg"), **dict.fromkeys(("rad", "rads", "radians"), "rad"),
        **dict.fromkeys(("rev", "revs", "turns"), "rev"), "mm": "mm", "cm": "cm",
        **dict.fromkeys(("count", "counts", "tick", "ticks"), "counts"),
    },
    VELOCITY: {
        **dict.fromkeys(("dps", "degs", "degps", "deg"), "deg/s"), **dict.fromkeys(("rad", "rads", "radps"), "rad/s"),
        **dict.fromkeys(("rps", "rev"), "rev/s"), "rpm": "rpm", "mm": "mm/s", "mmps": "mm/s", "cm": "cm/s",
        "mps": "m/s",
        **dict.fromkeys(("count", "counts", "tick", "ticks"), "counts"),
    },
    COMMAND: {
        "mnm": "mNm", "nm": "Nm", "ncm": "Ncm", "mv": "mV", **dict.fromkeys(("v", "volt", "volts"), "V"), "ma": "mA",
        **dict.fromkeys(("amp", "amps"), "A"), **dict.fromkeys(("pct", "percent"), "%"), "deg": "deg", "rad": "rad",
        "rpm": "rpm", "dps": "deg/s", "mm": "mm",
    },
}  # fmt: skip
"""Words that are units, by the kind of quantity, in lower case."""
LAST_UNITS = {POSITION: {"m": "m"}, VELOCITY: {}, COMMAND: {"N": "N", "V": "V", "A": "A"}}
"""Single letters, which are units only at the end of a name."""
PER_SECOND = re.compile(r"(?<![A-Za-z])(deg|rad|rev|mm|cm|m)(?:/|_per_|p|_)s(?![A-Za-z])")
TIME_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "micros", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), "ns"),
}
TIME_WORDS = {"t", "time", "times", "timestamp", "timestamps", "stamp", "clock", "log", "secs", "seconds", *TIME_UNITS}


def parts_of(name: str) -> list[str]:
    """Parts of a name as they are written: ``tau_mNm`` has ``tau`` and ``mNm``."""
    return [part for part in re.split(r"[^A-Za-z0-9%]+", name) if part]


def words_of(name: str) -> list[str]:
    """Words and numbers of a name in lower case: ``elbowPos2`` has ``elbow``, ``pos`` and ``2``."""
    found = []
    for part in parts_of(name):
        pieces = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+|[A-Z]", part)
        found += [piece.lower() for piece in pieces]
        if len(pieces) > 1 and not any(c.isdigit() for c in part):
            found.append(part.lower())  # mNm is a word, too
    return [word.lstrip("0") or "0" if word.isdigit() else word for word in found]


def kind_of(name: str) -> str:
    """What a column's name says it is: a position, velocity, command or something else; empty if it does not."""
    words = set(words_of(name))
    if words & NEITHER:
        return OTHER_KIND
    if words & COMMANDED:
        return COMMAND
    if words & MOVING or PER_SECOND.search(name):
        return VELOCITY
    if words & DRIVING:
        return COMMAND
    last = parts_of(name)[1:][-1:]
    ends = [kind for kind in (POSITION, COMMAND) if last and last[0] in LAST_UNITS[kind]]
    return POSITION if words & PLACED else ends[0] if ends else ""


def wants_motion(name: str) -> bool:
    """Whether a command's name says that it is a position or velocity that somebody wanted, and not a torque."""
    words = set(words_of(name))
    return bool(words & COMMANDED and words & (MOVING | PLACED) and not words & DRIVING)


def named_unit(name: str, kind: str) -> tuple[str, str]:
    """The unit in a column's name, as a map has it (``counts`` without their number), and the word that tells it.

    Both are empty if none is there.
    """
    if found := PER_SECOND.search(name):
        if kind == VELOCITY:
            return f"{found[1]}/s", found[0]
        if kind == COMMAND and found[1] in ("deg", "rad", "m"):
            return f"{found[1]}/s", found[0]
    parts = parts_of(name)
    for part in reversed(parts):
        if len(parts) > 1 and part == parts[-1] and part in LAST_UNITS[kind]:
            return LAST_UNITS[kind][part], part
        if unit := SUBJECT_UNITS[kind].get(part.lower()):
            return unit, part
    return "", ""


def telling_words(name: str) -> set[str]:
    """Words of a joint's or actuator's name that tell it from others."""
    words = set(words_of(name))
    return words - GENERIC or words


def agreement(wanted: set[str], name: str) -> float:
    """Share of the wanted words that a column's name has, 0 to 1."""
    return len(wanted & set(words_of(name))) / max(len(wanted), 1)
