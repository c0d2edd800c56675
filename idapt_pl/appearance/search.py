"""Which visual effects does the source lack? A search that adds one at a time and judges each on episodes held out.

From :class:`FirstFrames` of the source and first frames of the target, both without any knowledge of how things move.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from idapt_pl.appearance.first_frames import FirstFrames, MeanImage, ParameterValues
from idapt_pl.appearance.fit import PIXEL, AppearanceFit, fit_parameters
from idapt_pl.appearance.parameters import VisualParameter, visual_parameters
from idapt_pl.effects import WHOLE, Domain, View
from idapt_pl.tasks import Task

log = logging.getLogger(__name__)
NOTICEABLE_SHARE = 0.05
"""Share of the held-out squared error beyond noise that an effect must remove to be added, and to stay."""
LEAST_ERROR = 0.3 * PIXEL
"""Error beyond noise that is not looked into."""
CHANCE = 4.0
"""How many times its expected square the noise may be beyond that. Starts differ in few ways, so that a mean of
pictures is off in few ways at once, by much or by little: in two of them, by this much or more in 1 of 150 cases."""
STARTS = 16
"""Starts drawn in the source for a mean picture."""
Refit = Callable[..., AppearanceFit]
"""Knobs to be turned with where they start, knobs that are held, and whether to begin with coarse pictures."""


@dataclass(frozen=True)
class HeldOutError:
    """Errors of mean pictures on what nothing was fitted to.

    Attributes:
        frames: source, with starts of its own.
        measured: of held-out episodes.
        floor: mean square that noise alone leaves.
    """

    frames: FirstFrames
    measured: MeanImage
    floor: float

    @property
    def least(self) -> float:
        """Mean square that is not looked into."""
        return CHANCE * self.floor + LEAST_ERROR**2

    @classmethod
    def of(cls, frames: FirstFrames, measured: MeanImage) -> HeldOutError:
        """With the floor that the spread of both gives."""
        noise = MeanImage.of(frames({})).variance + measured.variance
        return cls(frames, measured, float(noise.mean()))

    def __call__(self, settings: ParameterValues) -> float:
        """Mean square over pixels and colours, beyond noise; not below zero."""
        return max(0.0, float(np.square(self.frames.mean(settings) - self.measured.mean).mean()) - self.floor)


@dataclass(frozen=True)
class VisualEffects:
    """What was found.

    Attributes:
        settings: knob to its values.
        spread: knob to their standard deviations.
        before: held-out error, root mean square, in 8-bit levels, noise taken off.
        after: with what was found.
        floor: what noise alone leaves.
        trail: error after each step of the search.
        pictures: mean pictures (H, W, 3) of source, repaired source and target, 0 to 1.
    """

    settings: ParameterValues
    spread: ParameterValues
    before: float
    after: float
    floor: float
    trail: tuple[tuple[str, float], ...]
    pictures: tuple[np.ndarray, np.ndarray, np.ndarray]


def find_visual_effects(
    task: Task, source: Domain, begins: np.ndarray, seed: int, view: View = WHOLE, max_effects: int = 8,
    draws: int = STARTS,
) -> VisualEffects:  # fmt: skip
    """Find what about the source's pictures is different from the target's.

    Args:
        task: draws what episodes begin with.
        source: the domain to be repaired; drawn by the classic renderer.
        begins: first frames of the target's episodes, uint8 (n, H, W, 3), n at least 4.
        seed: of the starts drawn in the source.
        view: the part of the camera's image that is rendered.
        max_effects: stop after so many.
        draws: starts drawn in the source for a mean picture.

    Raises:
        ValueError: if there are fewer than four episodes, frames are not square, or the source is drawn by another
            engine.
    """
    if begins.ndim != 4 or begins.shape[1] != begins.shape[2]:
        raise ValueError(f"first frames must be square images (n, size, size, 3), got shape {begins.shape}")
    if len(begins) < 4:
        raise ValueError(f"visual effects need the first frames of at least 4 episodes, got {len(begins)}: record more")
    size, fitted, held_out = begins.shape[1], MeanImage.of(begins[::2]), MeanImage.of(begins[1::2])
    with (
        FirstFrames(task, source, size, draws, seed, view) as frames,
        FirstFrames(task, source, size, draws, seed + 1, view) as others,
    ):
        judge = HeldOutError.of(others, held_out)
        variance = MeanImage.of(frames({})).variance

        def refit(start: ParameterValues, held: ParameterValues, coarse: bool = False) -> AppearanceFit:
            return fit_parameters(frames.mean, fitted, variance, start, held, coarse)

        found, trail = add_parameters(refit, judge, visual_parameters(source.spec()), max_effects)
        found = remove_needless(found, refit, judge)
        before, after, floor = (255 * math.sqrt(e) for e in (judge({}), judge(found.values), judge.floor))
        pictures = others.mean({}), others.mean(found.values), held_out.mean
    return VisualEffects(found.values, found.spread, before, after, floor, trail, pictures)


def add_parameters(
    refit: Refit, judge: HeldOutError, candidates: Sequence[VisualParameter], most: int
) -> tuple[AppearanceFit, tuple[tuple[str, float], ...]]:
    """Add the knob that removes most of the held-out error, refit all, until none removes a noticeable share.

    A camera, and then blur, can stand in for much else, so they are tried when nothing simpler helps any more.
    """
    found, trail, error = AppearanceFit({}, {}), [], judge({})
    while len(found.values) < most and error > judge.least:
        rest = [k for k in candidates if k not in found.values]
        ranks = sorted({k.rank for k in rest})
        # What was added before may have stood in for a knob of higher rank, which is therefore tried on its own too.
        bases = [(rank, base) for rank in ranks for base in ([AppearanceFit({}, {}), found] if rank else [found])]
        trials = (best_addition([k for k in rest if k.rank == rank], base, refit, judge) for rank, base in bases)
        new = next((t for t in trials if judge(t.values) <= (1 - NOTICEABLE_SHARE) * error), None)
        if new is None:
            break
        found, error = new, judge(new.values)
        trail.append((" ".join([*new.values][-1].key), 255 * math.sqrt(error)))
        log.info("visual effect: %s, error %.2f levels", *trail[-1])
    return found, tuple(trail)


def best_addition(
    trial: Sequence[VisualParameter], found: AppearanceFit, refit: Refit, judge: HeldOutError
) -> AppearanceFit:
    """The knob that helps most when it is turned alone, and then all together."""
    trials = ({**found.values, **refit({k: k.nominal}, found.values, coarse=True).values} for k in trial)
    together = min(trials, key=judge)
    return min((refit(together, {}, coarse) for coarse in (False, True)), key=lambda fit: judge(fit.values))


def remove_needless(found: AppearanceFit, refit: Refit, judge: HeldOutError) -> AppearanceFit:
    """Take out what the others can do without; what was added early may have stood in for what came later."""
    for knob in found.values:
        if len(found.values) > 1 and knob in found.values:
            without = refit({k: v for k, v in found.values.items() if k is not knob}, {})
            if judge(found.values) + judge.least > (1 - NOTICEABLE_SHARE) * (judge(without.values) + judge.least):
                log.info("visual effect: %s is not needed", " ".join(knob.key))
                found = without
    return found
