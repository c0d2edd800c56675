"""Where sensors are so good that noise explains nothing: models are judged by the forces that they leave unexplained.

An industrial arm reports positions to a tenth of a microradian. No model of friction is as good, so every model is off
by thousands of standard deviations of that noise, and what forecasts best over a quarter of a second is that all goes
on as it goes: a rotor inertia so large that no torque matters. What tells models apart then is the force that each
leaves unexplained, as in identification by inverse dynamics (Gautier, ICRA 1997).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState, renew
from idapt_pl.estimation.robust import robust_deviation
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.force_windows import instants_of, lacking_forces, measured_motion
from idapt_pl.prediction.simulator import Effects, Simulator

FAR_BEYOND, HOPELESS = 1e3, 1e5
"""Held-out loss of a finished search from which noise is no yardstick, and that of one that leads nowhere."""

UNEXPLAINED, TELLING = 10.0, 3.0
"""Held-out loss above which an answer is asked whether it contradicts forces, and how far those must be above noise."""

FORCE_RIDGE = 1e-4
"""Of the regression, in units of the number of instants."""


def beyond_noise(context: SearchContext, state: SearchState, loss: float = FAR_BEYOND) -> bool:
    """Whether what a search has left is far beyond noise, and it does not judge by forces yet.

    Accelerations have to be measured: where velocities are but slopes of positions, nothing is.
    """
    if context.known_noise is not None or state.windows.noise.forces is not None or not context.sim.velocities:
        return False
    return float(context.loss(state.windows.held_out, state.effects).mean()) > loss


def contradicts_forces(context: SearchContext, state: SearchState) -> bool:
    """Whether effects leave much of forecasts unexplained, and more force than the model as it was given lacks.

    What goes on as it goes is forecast well by a rotor of great inertia, which takes torques that nobody measured.
    Forces count in units of what a black box leaves of them, and tell nothing where they are near it. What the noise of
    velocities makes of them does not count: a heavy body that is rightly named makes much of it.
    """
    if not state.accepted or not beyond_noise(context, state, UNEXPLAINED):
        return False
    given = replace(state, accepted=())
    nothing_explains, instants = unexplained_forces(context, given), instants_of(state.windows.sensitivity.held_out)
    noisier = with_more_noise(context, state)

    def left(effects: Effects) -> float:
        lacking = lacking_forces(context.sim, effects, instants)
        noise = lacking_forces(noisier, effects, instants) - lacking
        typical, by_noise = (robust_deviation(x) for x in (lacking, noise))
        surely = np.maximum(np.square(typical) - np.square(by_noise), 0.0)
        return float(np.sqrt((surely / np.square(nothing_explains + 1e-12)).mean()))

    before, after = left(given.effects), left(state.effects)
    return TELLING < before < after


def with_more_noise(context: SearchContext, state: SearchState) -> Simulator:
    """The recordings with the noise of velocities once more."""
    rng, nv = np.random.default_rng(context.seed), context.sim.model.nv
    size = state.windows.noise.sensors[nv : 2 * nv]
    return context.sim.replaying(
        [replace(r, qvel=r.qvel + size * rng.normal(size=r.qvel.shape)) for r in context.sim.data]
    )


def judge_by_forces(context: SearchContext, state: SearchState, size: np.ndarray) -> SearchState:
    """The state, its windows judged by forces in units of ``size``, (nv,)."""
    noise = replace(state.windows.noise, forces=size)
    return renew(context, replace(state, windows=replace(state.windows, noise=noise)))


def judge_by_noise(context: SearchContext, state: SearchState) -> SearchState:
    """The state judged by forecasts and the noise of sensors again, where these have become near each other."""
    noise = replace(state.windows.noise, forces=None)
    plain = renew(context, replace(state, windows=replace(state.windows, noise=noise)))
    return state if beyond_noise(context, plain) else plain


def unexplained_forces(context: SearchContext, state: SearchState) -> np.ndarray:
    """Standard deviation of the force on each degree of freedom that nothing explains, (nv,).

    By inverse dynamics, less what a ridge regression on motion, place and commands says of it, which is fitted to the
    fitted episodes and judged on the others; outliers count little.
    """
    fit, judged = state.windows.sensitivity.fit, state.windows.sensitivity.held_out
    force, other = (lacking_forces(context.sim, state.effects, instants_of(w)) for w in (fit, judged))
    left, rows = [], min(len(force), len(other))
    for v in range(context.sim.model.nv):
        features = features_of(context, fit, v, rows), features_of(context, judged, v, rows)
        left.append(robust_deviation(other[:, v] - predicted(*features, force[:, v])))
    return np.array(left)


def features_of(context: SearchContext, windows: Windows, v: int, rows: int) -> np.ndarray:
    """What may explain the force on a degree of freedom in the control steps of windows, (n, f).

    Products of two places are among them where ``rows``, of the smaller part of the recordings, are many enough.
    """
    sim, instants = context.sim, instants_of(windows)
    motion = measured_motion(sim, instants)
    commands = np.stack([sim.data[e].actions[s] for e, s in zip(instants.episode, instants.start, strict=True)])
    speed = motion.qvel[:, v]
    soft = np.tanh(speed / (0.1 * speed.std() + 1e-9))
    own = np.stack([speed, np.sign(speed), speed * np.abs(speed), soft, np.ones(len(speed))], 1)
    place = np.concatenate([np.sin(motion.qpos), np.cos(motion.qpos)], 1)
    i, j = np.triu_indices(place.shape[1])
    pairs = place[:, i] * place[:, j] if 20 * len(i) < rows else place[:, :0]
    return np.concatenate([own, motion.qacc, commands, place, pairs], 1)


def predicted(known: np.ndarray, at: np.ndarray, force: np.ndarray) -> np.ndarray:
    """What a ridge regression of a force (n,) on features (n, f) says of it in other instants, (m,)."""
    spread = known.std(0)
    spread = np.where(spread > 1e-9, spread, 1.0)
    A, B, middle = known / spread, at / spread, force.mean()
    H = A.T @ A + FORCE_RIDGE * len(A) * np.eye(A.shape[1])
    return middle + B @ np.linalg.solve(H, A.T @ (force - middle))
