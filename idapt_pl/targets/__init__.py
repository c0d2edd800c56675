"""What a run's target can be: another domain, somebody else's simulation, or a robot."""

from idapt_pl.targets.from_config import make_target, target_name
from idapt_pl.targets.recorded import RecordedTarget
from idapt_pl.targets.target import Look, OtherTaskTarget, RobotTarget, SimulatedTarget, Target

__all__ = [
    "Look",
    "OtherTaskTarget",
    "RecordedTarget",
    "RobotTarget",
    "SimulatedTarget",
    "Target",
    "make_target",
    "target_name",
]
