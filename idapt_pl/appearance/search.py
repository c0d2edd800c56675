"""Which visual effects does the source lack? A search that adds one at a time and judges each on episodes held out.

From :class:`FirstFrames` of the source and first frames of the target, both without any knowledge of how things move.
"""

from __future__ import annotations

import base64
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import imageio.v3 as iio
import numpy as np

from idapt_pl.appearance.first_frames import FirstFrames, MeanImage, ParameterValues
from idapt_pl.appearance.fit import PIXEL, AppearanceFit, fit_parameters
from idapt_pl.appearance.parameters import VisualParameter, visual_parameters
from idapt_pl.appearance.result import VisualEffects, VisualEstimate
from idapt_pl.effects import WHOLE, Domain, View
from idapt_pl.estimation.stepwise import backward_elimination, forward_selection
from idapt_pl.tasks import Task

log = logging.getLogger(__name__)
NOTICEABLE_SHARE = 0.05
"""Share of the held-out squared error beyond noise that an effect must remove to be added, and to stay."""
LEAST_ERROR = 0.3 * PIXEL
"""Error beyond noise that is not looked into."""
NOISE_MULTIPLE = 4.0
"""How many times its expected square the noise may be beyond that. Starts differ in few ways, so that a mean of
pictures is off in few ways at once, by much or by little: in two of them, by this much or more in 1 of 150 cases."""
SOURCE_STARTS = 16
"""Starts drawn in the source for a mean picture."""
MOST_STEPS = 100
"""Of the search; more than the error allows, of which each step takes away a noticeable share. They can be more than
the parameters that are found, since one of a higher rank may take the place of all that were found before it."""
Refit = Callable[..., AppearanceFit]
"""Parameters to be fitted with where they start, parameters that are held, whether to begin with coarse pictures."""
Trail = tuple[tuple[str, float], ...]
"""Parameter that was added, and held-out error after that in 8-bit levels, for each step of the search."""


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
        return NOISE_MULTIPLE * self.floor + LEAST_ERROR**2

    @classmethod
    def of(cls, frames: FirstFrames, measured: MeanImage) -> HeldOutError:
        """With the floor that the spread of both gives."""
        noise = MeanImage.of(frames({})).variance + measured.variance
        return cls(frames, measured, float(noise.mean()))

    def __call__(self, settings: ParameterValues) -> float:
        """Mean square over pixels and colours, beyond noise; not below zero."""
        return max(0.0, float(np.square(self.frames.mean(settings) - self.measured.mean).mean()) - self.floor)


def find_visual_effects(
    task: Task, source: Domain, begins: np.ndarray, seed: int, view: View = WHOLE, max_effects: int = 8,
    draws: int = SOURCE_STARTS,
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
        error_of = HeldOutError.of(others, held_out)
        variance = MeanImage.of(frames({})).variance

        def refit(start: ParameterValues, held: ParameterValues, coarse: bool = False) -> AppearanceFit:
            return fit_parameters(frames.mean, fitted, variance, start, held, coarse)

        found, trail = add_parameters(refit, error_of, visual_parameters(source.spec()), max_effects)
        found = remove_needless(found, refit, error_of)
        before, after, floor = map(in_levels, (error_of({}), error_of(found.values), error_of.floor))
        pictures = others.mean({}), others.mean(found.values), held_out.mean
    spec = source.spec()
    effects = tuple(e for p, values in found.values.items() for e in p.effects(spec, values))
    return VisualEffects(effects, estimates_of(found), before, after, floor, trail, pictures_in_a_row(pictures))


def add_parameters(
    refit: Refit, error_of: HeldOutError, candidates: Sequence[VisualParameter], most: int
) -> tuple[AppearanceFit, Trail]:
    """Add the parameter that removes most of the held-out error, refit all, until none removes a noticeable share.

    A camera, and then blur, can stand in for much else, so they are tried when nothing simpler helps any more.
    """

    def step(state: tuple[AppearanceFit, Trail, float], taken: int) -> tuple[tuple[AppearanceFit, Trail, float], bool]:
        found, trail, error = state
        if len(found.values) >= most or error <= error_of.least:
            return state, False
        trials = candidate_fits(refit, error_of, candidates, found)
        new = next((t for t in trials if error_of(t.values) <= (1 - NOTICEABLE_SHARE) * error), None)
        if new is None:
            return state, False
        error, added = error_of(new.values), [*new.values][-1]
        trail = (*trail, (" ".join(added.key), in_levels(error)))
        log.info("visual effect: %s, error %.2f levels", *trail[-1])
        return (new, trail, error), True

    nothing = AppearanceFit({}, {})
    found, trail, _ = forward_selection((nothing, (), error_of({})), step, MOST_STEPS)
    return found, trail


def candidate_fits(
    refit: Refit, error_of: HeldOutError, candidates: Sequence[VisualParameter], found: AppearanceFit
) -> Iterator[AppearanceFit]:
    """What was found with the best parameter of each rank added, the simplest rank first.

    What was added before may have stood in for a parameter of higher rank, which is therefore tried on its own first.
    """
    rest = [p for p in candidates if p not in found.values]
    for rank in sorted({p.rank for p in rest}):
        for base in (AppearanceFit({}, {}), found) if rank else (found,):
            yield best_addition([p for p in rest if p.rank == rank], base, refit, error_of)


def best_addition(
    candidates: Sequence[VisualParameter], found: AppearanceFit, refit: Refit, error_of: HeldOutError
) -> AppearanceFit:
    """The parameter that helps most when it is fitted alone, and then all together."""
    trials = ({**found.values, **refit({p: p.nominal}, found.values, coarse=True).values} for p in candidates)
    together = min(trials, key=error_of)
    return min((refit(together, {}, coarse) for coarse in (False, True)), key=lambda fit: error_of(fit.values))


def remove_needless(found: AppearanceFit, refit: Refit, error_of: HeldOutError) -> AppearanceFit:
    """Take out what the others can do without; what was added early may have stood in for what came later."""

    def without(fit: AppearanceFit, parameter: VisualParameter) -> AppearanceFit | None:
        smaller = refit({p: values for p, values in fit.values.items() if p is not parameter}, {})
        with_it, without_it = (error_of(f.values) + error_of.least for f in (fit, smaller))
        if with_it <= (1 - NOTICEABLE_SHARE) * without_it:
            return None
        log.info("visual effect: %s is not needed", " ".join(parameter.key))
        return smaller

    return backward_elimination(found, list(found.values), without)


def estimates_of(fit: AppearanceFit) -> tuple[VisualEstimate, ...]:
    """What was fitted, by name."""
    return tuple(
        VisualEstimate(p.name, p.target, p.unit, p.by_label(p.nominal), p.by_label(values), p.by_label(fit.std[p]))
        for p, values in fit.values.items()
    )


def in_levels(mean_square: float) -> float:
    """Root of a mean square error of pictures from 0 to 1, in 8-bit levels."""
    return 255 * math.sqrt(mean_square)


def pictures_in_a_row(pictures: Sequence[np.ndarray]) -> str:
    """Pictures (H, W, 3), 0 to 1, in a row, as a PNG in base64."""
    row = np.rint(255 * np.concatenate(pictures, 1).clip(0, 1)).astype(np.uint8)
    return base64.b64encode(iio.imwrite("<bytes>", row, extension=".png")).decode()
