"""A robot's model from MJCF or URDF, what was lost of a URDF, and actuators where it has none.

``read.read_robot`` is the way in for a diagnosis, ``robot_spec`` of tasks that for a task.
"""
