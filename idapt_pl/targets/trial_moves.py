"""Which way things move in the image when an actuator is pushed: to compare a source with a target before a run."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass

import gymnasium
import numpy as np
from scipy.ndimage import gaussian_filter

from idapt_pl.envs import ImageEnv

SEEN, MOVING = 6.0, 0.15
"""Grey levels by which a pixel must change to be seen; share of the largest change, once blurred, for a moving one."""

CAMERA_NOISE = 1.75
"""Grey levels of one colour, once blurred, by which a camera's noise changes pixels of a still image."""

CELLS = 4
"""Rows and columns of the parts of an image in which motions are compared."""

SHARP = 16
"""Images are blurred by their side over this, standard deviation."""

PUSHED_SECONDS, PUSHED_STEPS = 0.4, 6
"""How long an actuator is pushed: so many seconds, and control steps at least."""

ALIKE, UNLIKE = 0.6, -0.6
"""Cosines between two directions that are taken to be the same, and opposite."""

LITTLE = 3.0
"""Pixels that things must move by, over all cells, for a direction to tell."""

FASTER = 4.0
"""Factor by which things may move faster or slower than in the source before it is said."""

SLOWER, QUICKER = 1.25, 0.8
"""Factors of the control period beyond which a step that takes so long is another one."""


@dataclass(frozen=True)
class TrialMoves:
    """What a world shows when its actuators are pushed, one by one.

    Attributes:
        start: the first frame, uint8 (S, S, 3).
        plus: the last frame after a push one way, for each actuator, uint8 (nu, S, S, 3).
        minus: the other way.
        motion: how far things moved with one push less the other, in each cell of the image, right and down, pixels
            (nu, CELLS, CELLS, 2).
        steps: control steps that it took.
        ended: control steps after which the shortest push ended its episode; None where none did.
        took: median time of a control step, s; 0 if unknown.
    """

    start: np.ndarray
    plus: np.ndarray
    minus: np.ndarray
    motion: np.ndarray
    steps: int
    ended: int | None = None
    took: float = 0.0


def try_moves(env: ImageEnv, share: float, seed: int = 0) -> TrialMoves:
    """Push every actuator both ways, each time from a new start, until an episode ends at most.

    Args:
        env: one simulation, or one robot.
        share: of the actuators' ranges, about their middles.
        seed: of the starts.
    """
    steps = max(PUSHED_STEPS, round(PUSHED_SECONDS / env.dt))
    space = env.single_action_space
    assert isinstance(space, gymnasium.spaces.Box)
    middle, half = (space.high + space.low) / 2, (space.high - space.low) / 2
    ends, motions, taken, start = [], [], 0, np.zeros(0)
    lasted: list[int] = []
    times: list[float] = []
    for i in range(len(middle)):
        for sign in (1.0, -1.0):
            action = middle.copy()
            action[i] += sign * share * half[i]
            frames = [env.reset(seed=seed)[0]["pixels"][0, -1]]
            start = frames[0]
            for _ in range(steps):
                begin = time.perf_counter()
                obs, _, terminations, truncations, infos = env.step(action[None].astype(np.float32))
                times.append(time.perf_counter() - begin)
                taken += 1
                frames.append(infos.get("final_obs", obs)["pixels"][0, -1])
                if terminations[0] or truncations[0]:
                    lasted.append(len(frames) - 1)
                    times.pop()  # a reset was in it
                    break
            ends.append(frames[-1])
            motions.append(apparent_motion(frames))
    plus, minus = np.array(ends[::2]), np.array(ends[1::2])
    motion = np.array(motions[::2]) - np.array(motions[1::2])
    took = float(np.median(times)) if times else 0.0
    return TrialMoves(start, plus, minus, motion, taken, min(lasted, default=None), took)


def apparent_motion(frames: Sequence[np.ndarray]) -> np.ndarray:
    """How far what moves has moved in each cell of a sequence of images, right and down, pixels (CELLS, CELLS, 2).

    From frame to frame, by least squares over pixels that change, in each colour (Lucas and Kanade 1981): what moves
    may be as bright as what is behind it.
    """
    total = np.zeros((CELLS, CELLS, 2))
    blur = frames[0].shape[0] / SHARP  # thin parts may move by more than they are wide
    soft = [gaussian_filter(frame.astype(float), (blur, blur, 0)) for frame in frames]
    for before, after in itertools.pairwise(soft):
        change = after - before
        least = max(MOVING * np.abs(change).max(), CAMERA_NOISE)
        down, right = np.gradient((before + after) / 2, axis=(0, 1))
        parts = zip(*(in_cells(part) for part in (right, down, change)), strict=True)
        for cell, (r, d, c) in zip(np.ndindex(CELLS, CELLS), parts, strict=True):
            moving = np.abs(c) > least
            if moving.sum() >= 3:
                slopes = np.vstack([np.column_stack([r[moving], d[moving]]), np.eye(2)])
                total[cell] += np.linalg.lstsq(slopes, np.append(-c[moving], [0, 0]), rcond=None)[0]
    return total


def in_cells(image: np.ndarray) -> list[np.ndarray]:
    """The cells of an image (H, W, 3), row by row."""
    return [cell for row in np.array_split(image, CELLS) for cell in np.array_split(row, CELLS, axis=1)]


def suspicions(
    source: TrialMoves,
    target: TrialMoves | None,
    names: Sequence[str],
    shown: np.ndarray | None = None,
    frame_stack: int = 1,
) -> list[str]:
    """What looks wrong, a sentence each.

    Args:
        source: when its actuators were pushed.
        target: the same; None if it was not pushed.
        names: of the actuators.
        shown: the target's first image, uint8 (S, S, 3), if it was not pushed but seen.
        frame_stack: images in an observation.
    """
    found = [
        f"{names[i]} moves nothing that the source's camera sees" for i in range(len(names)) if not visible(source, i)
    ]
    starts = {"source": source.start, "target": shown if target is None else target.start}
    for what, start in starts.items():
        if start is not None and of_one_colour(start):
            found.append(f"the {what}'s image is nearly of one colour: is the camera where it should be?")
    if target is None:
        return found
    if target.ended is not None and target.ended < frame_stack:
        found.append(
            f"an episode of the target ends after {target.ended} control step{'s' * (target.ended > 1)} of a push, and "
            f"an observation has {frame_stack} images (frame_stack)"
        )
    elif target.ended is not None and 2 * target.ended < (source.ended or PUSHED_STEPS):
        found.append(
            f"an episode of the target ends after {target.ended} control step{'s' * (target.ended > 1)} of a push, the "
            "source's later: do they begin and end alike?"
        )
    both = [i for i in range(len(names)) if visible(source, i)]
    found += [f"{names[i]} moves nothing that the target's camera sees" for i in both if not visible(target, i)]
    both = [i for i in both if visible(target, i)]
    return found + crossed(source.motion, target.motion, both, names)


def of_one_colour(image: np.ndarray) -> bool:
    """Whether hardly anything can be seen in an image, uint8 (S, S, 3)."""
    return bool(image.std((0, 1)).max() < SEEN)


def told_pace(took: float, period: float) -> str:
    """How long a control step took, and what that means if it is not the control period; both in s."""
    said = f"a control step of the target took {took:.3g} s, where the source's is {period:g} s long"
    if took > SLOWER * period:
        return f"{said}: if it is a robot it acts longer than in the source (a simulation may be slow)"
    if took < QUICKER * period:
        return f"{said}: if it is a robot its step must wait until the period is over (a simulation need not)"
    return said


def visible(world: TrialMoves, i: int) -> bool:
    """Whether a push of actuator i can be seen."""
    return bool(np.abs(world.plus[i].astype(float) - world.minus[i]).max() > SEEN and np.any(world.motion[i]))


def crossed(a: np.ndarray, b: np.ndarray, both: Sequence[int], names: Sequence[str]) -> list[str]:
    """Turned cameras, reversed signs, exchanged actuators, other speeds; from motions of source and target."""
    turned = {
        "upside down": -b[:, ::-1, ::-1],
        "mirrored left to right": b[:, :, ::-1] * (-1.0, 1.0),
        "mirrored top to bottom": b[:, ::-1] * (1.0, -1.0),
    }
    alike = lambda i, j: cosine(a[i], b[j])  # noqa: E731
    reversed_ = [i for i in both if alike(i, i) < UNLIKE]
    explaining = [how for how, there in turned.items() if all(cosine(a[i], there[i]) > ALIKE for i in both)]
    if len(both) == 1 and explaining and alike(both[0], both[0]) < ALIKE:
        way = "the other way" if reversed_ else "in another direction than in the source"
        return [
            f"{names[both[0]]} moves {way}: see the sign of target.actions.scale; or the target's image is "
            f"{' or '.join(explaining)}. One actuator that is seen does not tell which: look at the picture"
        ]
    if len(both) > 1 and explaining and any(alike(i, i) < ALIKE for i in both):
        alone = [names[i] for i in reversed_] if len(reversed_) < len(both) else []
        instead = f"; or {' and '.join(alone)} moves the other way (target.actions.scale: -1 there)" if alone else ""
        return [f"everything moves as if the target's image were {' or '.join(explaining)}{instead}"]
    found = []
    swapped = [
        (i, j) for i in both for j in both
        if i < j and alike(i, j) > ALIKE and alike(j, i) > ALIKE and max(alike(i, i), alike(j, j)) < ALIKE
    ]  # fmt: skip
    found += [f"{names[i]} and {names[j]} seem to be exchanged: see target.actions.order" for i, j in swapped]
    exchanged = {i for pair in swapped for i in pair}
    for i in (i for i in both if i not in exchanged):
        ratio = float(np.linalg.norm(b[i]) / np.linalg.norm(a[i]))
        if not 1 / FASTER < ratio < FASTER:
            found.append(f"{names[i]} moves things {ratio:.2g} times as far as in the source: are units the same?")
        elif i in reversed_:
            found.append(f"{names[i]} moves the other way: see the sign of target.actions.scale, and the camera")
        elif alike(i, i) < ALIKE and min(np.linalg.norm(a[i]), np.linalg.norm(b[i])) < LITTLE:
            found.append(f"{names[i]} moves too little to compare where to: push further, with --share 1")
        elif alike(i, i) < ALIKE:
            found.append(f"{names[i]} moves things in another direction than in the source: are the cameras alike?")
    return found


def cosine(a: np.ndarray, b: np.ndarray) -> float:
    """Of the angle between two fields of vectors."""
    return float((a * b).sum() / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-9))
