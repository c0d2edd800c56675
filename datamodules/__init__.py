"""Trajectory files and the LightningDataModules on top of them."""

from datamodules.torchvision_compat import ensure_torchvision

ensure_torchvision()  # before anything imports Lightning

from datamodules.on_policy import OnPolicyDataModule
from datamodules.replay import ReplayBuffer, ReplayDataModule
from datamodules.trajectories import (
    Episode,
    Trajectories,
    TrajectoryFileError,
    read_trajectories,
    write_trajectories,
)
from datamodules.unpaired import LabelledImages, UnpairedImages

__all__ = [
    "Episode",
    "LabelledImages",
    "OnPolicyDataModule",
    "ReplayBuffer",
    "ReplayDataModule",
    "Trajectories",
    "TrajectoryFileError",
    "UnpairedImages",
    "read_trajectories",
    "write_trajectories",
]
