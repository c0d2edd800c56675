"""Images of recordings: files, bytes and videos become frames of one size."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from datamodules.images.fitting import Fitted
from datamodules.recordings.errors import RecordingError, optional
from datamodules.recordings.mapping import Mapping

CHANNELS = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0), "rgba8": (0, 1, 2), "bgra8": (2, 1, 0), "mono8": (0, 0, 0)}
"""ROS encodings of raw images: where red, green and blue are."""


def fitted_frames(images: Iterable[np.ndarray], size: int) -> np.ndarray:
    """Images uint8 (h, w, 3), cropped to the square in their middle and scaled, uint8 (n, size, size, 3)."""
    fit = Fitted(size, size, "crop")
    frames = [fit(image) for image in images]
    return np.stack(frames) if frames else np.zeros((0, size, size, 3), np.uint8)


def image_column(name: str, array: np.ndarray, mapping: Mapping) -> dict[str, np.ndarray]:
    """An array uint8 (rows, H, W, 3) as a column of frames, if the map asks for it by this name; else nothing."""
    wanted = mapping.images is not None and mapping.images.column == name
    if not wanted or array.dtype != np.uint8 or array.ndim != 4 or array.shape[-1] != 3:
        return {}
    assert mapping.images is not None
    return {name: fitted_frames(array, mapping.images.size)}


def decoded_image(data: bytes | Path, where: str) -> np.ndarray:
    """A PNG, JPEG or other picture, uint8 (h, w, 3).

    Args:
        data: of the picture, or its file.
        where: it is from, for messages.

    Raises:
        RecordingError: if it is none.
    """
    try:
        with Image.open(io.BytesIO(data) if isinstance(data, bytes) else data) as image:
            return np.array(image.convert("RGB"))
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        told = "no such file" if isinstance(error, FileNotFoundError) else str(error) or type(error).__name__
        raise RecordingError(f"{where}: not a readable picture: {told}") from None


def raw_image(data: bytes, height: int, width: int, step: int, encoding: str, where: str) -> np.ndarray:
    """A raw image of ROS (``sensor_msgs/Image``), uint8 (h, w, 3).

    Args:
        data: its rows.
        height: rows.
        width: columns.
        step: bytes of a row.
        encoding: of :data:`CHANNELS`.
        where: it is from, for messages.

    Raises:
        RecordingError: if it has another encoding or size.
    """
    if encoding not in CHANNELS:
        raise RecordingError(f"{where}: images are encoded as {encoding!r}; known are {', '.join(CHANNELS)}")
    channels = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1}[encoding]
    if len(data) != height * step or step < width * channels or not width:
        raise RecordingError(f"{where}: an image of {width} x {height} has {len(data)} bytes, rows of {step}")
    rows = np.frombuffer(data, np.uint8).reshape(height, step)[:, : width * channels]
    return np.ascontiguousarray(rows.reshape(height, width, channels)[..., CHANNELS[encoding]])


def named_files(names: Iterable[object], folder: Path, size: int) -> np.ndarray:
    """Pictures whose files are named, relative to a folder or not, as frames (n, size, size, 3).

    Raises:
        RecordingError: naming the first that is not there or no picture.
    """
    return fitted_frames((decoded_image(folder / str(n), str(folder / str(n))) for n in names), size)


def video_frames(path: Path, first: int, count: int, size: int) -> np.ndarray:
    """So many frames of a video, from one on, (count, size, size, 3).

    Raises:
        RecordingError: if it cannot be read, or is too short.
    """
    av = optional("av", "av", path)
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; expected the episode's video")
    try:
        with av.open(str(path)) as container:
            pictures = itertools.islice(container.decode(video=0), first, first + count)
            frames = fitted_frames((picture.to_ndarray(format="rgb24") for picture in pictures), size)
    except (av.error.FFmpegError, OSError, IndexError) as error:
        raise RecordingError(f"{path}: not a readable video: {error}") from None
    if len(frames) < count:
        raise RecordingError(f"{path}: has {first + len(frames)} frames, expected at least {first + count}")
    return frames
