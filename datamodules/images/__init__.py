"""Images of two domains from folders, trajectory files and torchvision datasets, each loaded when it is asked for."""

from typing import TYPE_CHECKING

from datamodules.on_demand import on_demand

if TYPE_CHECKING:
    from datamodules.images.augmentation import Augmentation
    from datamodules.images.domains import ImageDomains
    from datamodules.images.files import ImageError, list_images, read_image
    from datamodules.images.fitting import Fitted
    from datamodules.images.frames import TrajectoryImages
    from datamodules.images.still import Reading, StillImages, from_dataset, from_folder
else:
    __getattr__ = on_demand(
        __name__,
        {
            "augmentation": "Augmentation",
            "domains": "ImageDomains",
            "files": "ImageError list_images read_image",
            "fitting": "Fitted",
            "frames": "TrajectoryImages",
            "still": "Reading StillImages from_dataset from_folder",
        },
    )

__all__ = [
    "Augmentation",
    "Fitted",
    "ImageDomains",
    "ImageError",
    "Reading",
    "StillImages",
    "TrajectoryImages",
    "from_dataset",
    "from_folder",
    "list_images",
    "read_image",
]
