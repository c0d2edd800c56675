"""A robot's model for a diagnosis from MJCF or URDF, what was lost of a URDF, and actuators where it has none.

:func:`~idapt_pl.robot_files.read.read_robot` is the way in.
"""

from idapt_pl.robot_files.actuators import add_actuators, parse_actuators
from idapt_pl.robot_files.read import RobotModel, read_robot

__all__ = ["RobotModel", "add_actuators", "parse_actuators", "read_robot"]
