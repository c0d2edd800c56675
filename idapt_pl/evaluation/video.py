"""Pictures and videos of what was learned: for TensorBoard, the run folder and the docs."""

from __future__ import annotations

import io
import logging
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from gymnasium.vector import VectorEnv
from tensorboard.compat.proto.summary_pb2 import Summary
from torch.utils.tensorboard import SummaryWriter

from idapt_pl.envs import TargetFailed
from idapt_pl.files import write_atomically
from idapt_pl.rl.policy import Policy, tick

log = logging.getLogger(__name__)


def record_video(env: VectorEnv, act: Policy, steps: int, seed: int) -> tuple[np.ndarray, int]:
    """What the first simulation's policy sees for ``steps`` control steps, or until a target fails.

    Returns:
        Frames uint8 (T, H, W, 3), and how many steps were taken.
    """
    obs, _ = env.reset(seed=seed)
    frames, taken = [obs["pixels"][0, -1]], 0
    try:
        while taken < steps:
            obs, _, terminations, truncations, _ = env.step(act(obs["pixels"]))
            tick(act, terminations | truncations)
            frames.append(obs["pixels"][0, -1])
            taken += 1
    except TargetFailed as failure:  # what was measured before counts
        log.warning("the video ends after %d steps: %s", taken, failure)
    return np.stack(frames[:steps]), taken


def side_by_side(*videos: np.ndarray, scale: int = 2, gap: int = 4) -> np.ndarray:
    """Videos (T, H, W, 3) next to each other, enlarged by whole pixels, white between them."""
    T, H = min(map(len, videos)), videos[0].shape[1]
    white = np.full((T, H * scale, gap, 3), 255, np.uint8)
    parts = [v[:T].repeat(scale, 1).repeat(scale, 2) for v in videos]
    return np.concatenate([p for part in parts for p in (part, white)][:-1], axis=2)


def gif(frames: np.ndarray, fps: float = 25.0) -> bytes:
    """An animated GIF that loops."""
    buffer = io.BytesIO()
    iio.imwrite(buffer, frames, extension=".gif", duration=1000 / fps, loop=0)
    return buffer.getvalue()


def gif_summary(tag: str, data: bytes) -> Summary:
    """An animated GIF as TensorBoard keeps it."""
    height, width = iio.improps(data, extension=".gif").shape[-3:-1]
    image = Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=data)
    return Summary(value=[Summary.Value(tag=tag, image=image)])


def log_video(folder: Path, tag: str, frames: np.ndarray, step: int) -> None:
    """Add a video to the run's TensorBoard page and keep it as ``<tag>.gif`` in ``folder``."""
    data = gif(frames)
    write_atomically(folder / f"{tag}.gif", lambda path: path.write_bytes(data))
    with SummaryWriter(folder.parent / "summary") as writer:
        writer._get_file_writer().add_summary(gif_summary(tag, data), step)


def log_scalars(folder: Path, values: dict[str, float], step: int) -> None:
    """Add scalars to the run's TensorBoard page, by grounding step."""
    with SummaryWriter(folder.parent / "summary") as writer:
        for tag, value in values.items():
            writer.add_scalar(tag, value, step)
