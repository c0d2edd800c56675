"""A cheap look at the many candidates of a large machine: what forces each adds, and what forces do to predictions.

To simulate every candidate takes a time that grows with the square of the joints: there are more of them, and each
simulation takes longer. Most of them act as forces. Inverse dynamics reads these off the mean motion of each control
step, and what a force does to a prediction is simulated once for every degree of freedom and control step. Windows are
short, so that changes add up. Only the order matters: the best are simulated
(:func:`~idapt_pl.diagnosis.rounds.screening.simulate_the_best`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from idapt_pl.diagnosis.candidates.listing import typical_sizes
from idapt_pl.diagnosis.candidates.periodogram import TorquePulse
from idapt_pl.diagnosis.rounds.force_response import force_response
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.effects.base import Effect
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.end_stops import JointRange
from idapt_pl.effects.joints import JointBacklash
from idapt_pl.effects.runtime import SensingEffect
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag, SensorDelay
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.whitening import WhitenedWindows

TRIAL_FORCE = 3.0
"""Size of the trial forces, in units of what would stop a joint within a forecast.

Much, as legs that stand slip at little ones, and what a solver of few iterations does with these is chance.
"""

NO_FORCES = (ActuatorDelay, ActuatorLag, SensorDelay, SensingEffect, JointBacklash, JointRange)
"""Effects that are no forces, or forces that change within a control step."""


def acts_as_force(c: Candidate) -> bool:
    """Whether what a candidate does is a force that hardly changes within a control step."""
    return not issubclass(c.kind, NO_FORCES)


def has_play(state: SearchState) -> bool:
    """Whether the model has joints with play: where in it they are, no instant tells."""
    return any(isinstance(e, JointBacklash) for e in state.effects)


def responses_by_forces(
    context: SearchContext, state: SearchState, split: WhitenedWindows
) -> Callable[[Effect], np.ndarray]:
    """What an effect changes in the whitened residuals of windows on top of the current model, (n, rows), roughly."""
    sim, windows, steps, nv = context.sim, split.windows, context.steps, context.sim.model.nv
    starts = windows.start[:, None] + np.arange(steps)
    instants = Windows(np.repeat(windows.episode, steps), starts.ravel(), np.zeros(1, int))
    torque = typical_sizes(sim.model, list(sim.data), context.horizon).torque
    response = force_response(context, state, split, np.arange(nv), TRIAL_FORCE * torque)
    time = np.stack([sim.data[e].time[k] for e, k in zip(windows.episode, starts, strict=True)])
    states = sim.mean_states(state.effects, instants)
    needed, qacc = sim.inverse_dynamics(state.effects, instants, states)

    def respond(effect: Effect) -> np.ndarray:
        if isinstance(effect, TorquePulse):
            k = sim.model.joint(effect.target).dofadr[0]
            return np.einsum("nrk,nk->nr", response[:, :, k], effect.at(time))
        forces = needed - sim.inverse_dynamics((*state.effects, effect), instants, states, qacc)[0]
        return np.einsum("nrvk,nkv->nr", response, forces.reshape(len(windows), steps, nv), optimize=True)

    return respond
