"""Deployment faults as values; :meth:`FaultReport.to_dict` is the entry ``deployment_faults`` of ``report.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import mujoco

from datamodules import Trajectories
from idapt_pl.deployment_faults.mend import Mend
from idapt_pl.deployment_faults.model_mend import mended_spec
from idapt_pl.deployment_faults.sequence import SequenceFaults, without_sequence_faults
from idapt_pl.deployment_faults.stale import without_stale_rows


class FaultKind(StrEnum):
    """What is wrong with a recording."""

    REPEATED_SAMPLES = "repeated_samples"
    CONTROL_PERIOD = "control_period"
    JOINT_ORDER = "joint_order"
    JOINT_SIGN = "joint_sign"
    JOINT_UNIT = "joint_unit"
    JOINT_ZERO = "joint_zero"
    POSITION_ORDER = "position_order"
    POSITION_SIGN = "position_sign"
    POSITION_UNIT = "position_unit"
    VELOCITY_ORDER = "velocity_order"
    VELOCITY_SIGN = "velocity_sign"
    VELOCITY_UNIT = "velocity_unit"
    VELOCITY_CLOCK = "velocity_clock"
    COMMAND_ORDER = "command_order"
    COMMAND_SIGN = "command_sign"
    COMMAND_UNIT = "command_unit"
    COMMAND_CLOCK = "command_clock"
    SERVO_AS_MOTOR = "servo_as_motor"
    MOTOR_AS_SERVO = "motor_as_servo"
    GRAVITY_TURNED = "gravity_turned"
    LOST_SAMPLES = "lost_samples"
    REORDERED_SAMPLES = "reordered_samples"
    WRONG_FIRST_SAMPLE = "wrong_first_sample"


@dataclass(frozen=True)
class DeploymentFault:
    """Something that is wrong with a recording, not with the model.

    Attributes:
        kind: what it is.
        targets: joints or actuators; ``*`` for the whole recording.
        estimate: how large: a factor, a time, an angle, or for orders the names of what the columns hold.
        unit: of the estimate.
        ci95: 95 % interval; None where the estimate is one of a few usual values.
        gain: log of the ratio of squared misses of forecasts without and with its cure, on held-out blocks.
        gain_error: its standard error.
        could_also_be: what explains the recording as well.
    """

    kind: FaultKind
    targets: tuple[str, ...]
    estimate: float | tuple[str, ...]
    unit: str = ""
    ci95: tuple[float, float] | None = None
    gain: float | None = None
    gain_error: float | None = None
    could_also_be: Sequence[str] = ()

    @property
    def where(self) -> str:
        """Its targets in words."""
        return "" if self.targets == ("*",) else ", ".join(self.targets)

    @property
    def value(self) -> str:
        """The estimate in words."""
        if isinstance(self.estimate, tuple):
            return ", ".join(self.estimate) + (f" {self.unit}" if self.unit else "")
        return f"{self.estimate:.4g}" + (f" {self.unit}" if self.unit else "")

    @property
    def words(self) -> str:
        """What is wrong, in a few words."""
        what, _, how = self.kind.value.partition("_")
        said = {
            FaultKind.REPEATED_SAMPLES: "samples repeat the one before",
            FaultKind.CONTROL_PERIOD: "the control period is wrong",
            FaultKind.COMMAND_CLOCK: "commands and measurements are shifted in time",
            FaultKind.VELOCITY_CLOCK: "velocities and positions are shifted in time",
            FaultKind.SERVO_AS_MOTOR: "commands are targets of servos, but the model has motors",
            FaultKind.MOTOR_AS_SERVO: "commands are torques, but the model has servos",
            FaultKind.GRAVITY_TURNED: "the base, and so gravity, is turned by 90 or 180 degrees",
            FaultKind.LOST_SAMPLES: "samples are missing, and time goes on as if they were not",
            FaultKind.REORDERED_SAMPLES: "samples are exchanged with the next one",
            FaultKind.WRONG_FIRST_SAMPLE: "episodes begin with samples that are no measurements",
        }
        named = {
            "order": f"{what} columns are in another order",
            "sign": f"the sign of the {what} is turned",
            "unit": f"the {what} is in another unit",
            "zero": f"the zero of the {what} is elsewhere",
        }
        return said.get(self.kind) or named[how]

    @property
    def cure(self) -> str:
        """What to do about it, as an order."""
        match self.kind:
            case FaultKind.REPEATED_SAMPLES:
                return "read the sensors at the control period; until then, interpolate"
            case FaultKind.LOST_SAMPLES:
                return "record time stamps; until then, insert the time and leave these steps out"
            case FaultKind.REORDERED_SAMPLES:
                return "sort by the sensors' own time stamps; until then, exchange them back"
            case FaultKind.WRONG_FIRST_SAMPLE:
                return "begin recording with the first message; until then, leave these samples out"
            case FaultKind.SERVO_AS_MOTOR:
                return f"give the model position servos ({self.value}), or log torques"
            case FaultKind.MOTOR_AS_SERVO:
                return "give the model motors, or log the servos' targets"
            case FaultKind.GRAVITY_TURNED:
                return f"set gravity to {self.value} in the model, or turn its base"
            case FaultKind.CONTROL_PERIOD:
                return f"multiply dt and time stamps by {self.value}"
            case FaultKind.JOINT_ZERO:
                return f"add {self.value} to the recorded position"
            case FaultKind.COMMAND_CLOCK | FaultKind.VELOCITY_CLOCK:
                way = "later" if isinstance(self.estimate, float) and self.estimate > 0 else "earlier"
                size = abs(self.estimate) if isinstance(self.estimate, float) else 0.0
                return f"move the recorded {self.kind.value.split('_')[0]} channels {size:.4g} s {way}"
        if isinstance(self.estimate, tuple):
            return f"take {self.where} from the columns recorded as {self.value}"
        channel = self.kind.value.split("_")[0]
        what = {"joint": "position and velocity", "command": "commands"}.get(channel, channel)
        return f"multiply the recorded {what} by {self.value}"

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {
            "fault": self.kind.value,
            "targets": list(self.targets),
            "estimate": list(self.estimate) if isinstance(self.estimate, tuple) else self.estimate,
            "unit": self.unit,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "gain": self.gain,
            "gain_error": self.gain_error,
            "could_also_be": list(self.could_also_be),
            "cure": self.cure,
        }


@dataclass(frozen=True, eq=False)
class FaultReport:
    """The faults of a recording, and what takes them out.

    Attributes:
        faults: that are certain.
        mend: what takes them out, but for samples that are repeated, lost, out of order or not there yet.
        repeats: whether there are repeated samples.
        sequence: what else is wrong with the rows.
        model: the nominal model.
        runtime_s: how long the tests took.
    """

    faults: tuple[DeploymentFault, ...]
    mend: Mend
    repeats: bool
    sequence: SequenceFaults
    model: mujoco.MjModel
    runtime_s: float

    def fixed(self, data: Trajectories) -> Trajectories:
        """The recording with all its faults taken out.

        Raises:
            ValueError: an episode is too short for a shift.
        """
        if not self.faults:
            return data
        if self.repeats:
            data, _ = without_stale_rows(self.model, data)
        return self.mend.apply(self.model, without_sequence_faults(data, self.sequence))

    def fixed_model(self, model: mujoco.MjSpec) -> mujoco.MjSpec:
        """The nominal model, where the fault is in its drives or in which way is down: another one."""
        return mended_spec(model, self.mend)

    def to_dict(self, fixed: bool) -> dict[str, Any]:
        """As in ``report.json``; ``fixed`` where the rest of the report is of the mended recording."""
        return {"fixed": fixed, "faults": [f.to_dict() for f in self.faults], "runtime_s": self.runtime_s}
