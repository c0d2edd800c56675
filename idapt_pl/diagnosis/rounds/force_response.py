"""How short forecasts respond to forces: what a term of a law would do to them, without simulating it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.effects.acting import ActingForces, MotionNow, joint_signals
from idapt_pl.effects.expression import parse_expression
from idapt_pl.effects.learned import JointSignals, LearnedForce
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.law_history import remembered
from idapt_pl.prediction.simulator import Effects
from idapt_pl.prediction.whitening import WhitenedWindows, whiten

PUSH = 0.1
"""Size of the trial force, in units of what would stop a joint within a forecast."""


def force_response(
    context: SearchContext, state: SearchState, split: WhitenedWindows, dofs: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """D whitened residual / d force on a degree of freedom in a control step of the window, (n, rows, dofs, steps).

    With a coarse time step where that does.

    Args:
        context: of the search.
        state: the current model.
        split: windows.
        dofs: degrees of freedom, (d,).
        size: of the trial force on each, (d,).
    """
    sim, n, steps = context.sim, len(split.windows), context.steps
    effects = context.with_coarse_numerics(state.effects, context.coarse_step(split, state.effects))
    base = sim.residual(effects, split.windows)

    def respond(pushed: tuple[int, float, int]) -> np.ndarray:
        v, force, k = pushed
        push = np.zeros((n, steps, sim.model.nv))
        push[:, k, v] = force
        return whiten(split.W, sim.residual(effects, split.windows, push=push) - base) / force

    every = [(v, force, k) for v, force in zip(dofs, size, strict=True) for k in range(steps)]
    responses = np.stack(sim.side_by_side.map(respond, every), -1)
    return responses.reshape(*responses.shape[:2], len(dofs), steps)


@dataclass(frozen=True)
class WindowSignals:
    """JointSignals of a joint in every control step of windows, from what was measured.

    Attributes:
        joint: its number.
        now: at the middle of each step, (n, steps) each.
    """

    joint: int
    now: JointSignals


def measured_signals_of(
    context: SearchContext, effects: Effects, windows: Windows, joints: list[int]
) -> list[WindowSignals]:
    """JointSignals of some joints, in the middle of each control step: the mean of the samples before and after.

    Commands are as they arrive under these effects, the mean of each control step.
    """
    sim, m, steps = context.sim, context.sim.model, context.steps
    at = windows.start[:, None] + np.arange(steps + 1)
    take = lambda name: np.stack([getattr(sim.data[e], name)[k] for e, k in zip(windows.episode, at, strict=True)])  # noqa: E731
    qpos, qvel, time = take("qpos"), take("qvel"), take("time")
    began = np.array([sim.data[e].time[0] for e in windows.episode])[:, None]
    commands = sim.commands.averaged(effects, windows, steps, sim.control_period)
    later = [Windows(windows.episode, windows.start + k, windows.offsets) for k in range(steps)]
    activation = np.stack([sim.activations.at(commands[:, k], w) for k, w in enumerate(later)], 1)
    flat = lambda x: x.reshape(len(x) * steps, x.shape[-1])  # noqa: E731
    middle = lambda x: flat(0.5 * (x[:, 1:] + x[:, :-1]))  # noqa: E731
    now = MotionNow(middle(qpos), middle(qvel), flat(commands), flat(activation),
                    middle(time[..., None])[:, 0] - np.repeat(began, steps, 1).ravel())  # fmt: skip
    motor, load = ActingForces(m, []).loads(now)
    return [
        WindowSignals(j, {k: x.reshape(-1, steps) for k, x in joint_signals(m, j, now, motor, load).items()})
        for j in joints
    ]


def term_values(
    context: SearchContext, effects: Effects, windows: Windows, seen: WindowSignals, formula: str
) -> np.ndarray:
    """What a formula without coefficients comes to in every control step of windows, (n, steps).

    ``effects``: of the model so far, of which those on commands count.
    """
    expression, steps = parse_expression(formula), context.steps
    shape = seen.now["q"].shape
    memory = np.zeros((*shape, 0))
    if expression.memories:
        law = LearnedForce(context.sim.model.joint(seen.joint).name, formula)
        acting, sim = ActingForces(context.sim.model, [law]), context.sim
        past = remembered(acting, sim.data, sim.commands.at_samples(effects))
        at = windows.start[:, None] + np.arange(steps + 1)
        samples = np.stack([past[e][k] for e, k in zip(windows.episode, at, strict=True)])
        memory = 0.5 * (samples[:, 1:] + samples[:, :-1])
    return np.broadcast_to(expression.value(seen.now, memory), shape)
