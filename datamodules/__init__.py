"""Trajectory files and the LightningDataModules on top of them, each loaded when it is first asked for.

Most of what is in this package needs neither torch nor Lightning, which take seconds to load.
"""

from typing import TYPE_CHECKING

import wrapt

from datamodules.on_demand import on_demand
from datamodules.torchvision_compat import ensure_torchvision

# before anything imports Lightning, which imports torch first
wrapt.register_post_import_hook(ensure_torchvision, "torch")

if TYPE_CHECKING:
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
else:
    __getattr__ = on_demand(
        __name__,
        {
            "on_policy": "OnPolicyDataModule",
            "replay": "ReplayBuffer ReplayDataModule",
            "trajectories": "Episode Trajectories TrajectoryFileError read_trajectories write_trajectories",
            "unpaired": "LabelledImages UnpairedImages",
        },
    )

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
