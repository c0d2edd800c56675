"""What looks wrong in recordings of a target, before a run learns from them."""

from __future__ import annotations

import numpy as np

from idapt_pl.targets.recorded import RecordedTarget
from idapt_pl.targets.target import Look
from idapt_pl.targets.trial_moves import SEEN, of_one_colour


def recorded_suspicions(target: RecordedTarget, look: Look) -> list[str]:
    """What looks wrong in all recordings that are there, a sentence each.

    Args:
        target: its files, or what was put into its inbox so far.
        look: size of images and of frame stacks.

    Raises:
        ValueError: naming a file that cannot be read, and what is wrong with it.
    """
    found, k = [], 0
    while target.brought(k) if target.inbox is not None else k < len(target.files):
        where = target.place(k) if target.inbox is not None else target.files[k]
        shown = [episode.observations["pixels"] for episode in target.recording(k, look)]
        found += [f"{where}: {sentence}" for sentence in wrong_images(shown, look.frame_stack)]
        k += 1
    return found


def wrong_images(episodes: list[np.ndarray], frame_stack: int) -> list[str]:
    """What looks wrong in the images of some episodes, each uint8 (T+1, S, S, 3)."""
    found, count = [], len(episodes)
    images = sum(map(len, episodes))
    flat = sum(of_one_colour(frame) for frames in episodes for frame in frames)
    if flat:
        found.append(f"{flat} of {images} images are nearly of one colour: did the camera see anything?")
    still = sum(len(e) > 1 and not (np.abs(e.astype(np.int16) - e[0]) > SEEN).any() for e in episodes)
    if still and flat < images:
        found.append(f"the images of {still} of {count} episodes never change: did the camera, and the robot, run?")
    short = [len(e) for e in episodes if len(e) < frame_stack + 1]
    if short:
        found.append(
            f"{len(short)} of {count} episodes have fewer than {frame_stack + 1} images, the shortest {min(short)}; an "
            f"observation has {frame_stack} (frame_stack), and one must come after an action"
        )
    return found
