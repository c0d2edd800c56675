"""A first F by trajectory matching: short replays of the target's recordings in the source, before GARAT refines it.

As in grounded action transformation (Hanna & Stone 2017), F should make the source move as the target was seen to
move; here through the simulator rather than through two learned models, since the source can be put into any state.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from mujoco import rollout
from torch import Tensor

from idapt_pl.effects import Domain
from idapt_pl.effects.acting import has_laws
from idapt_pl.estimation.least_squares import huber_weights, project_out
from idapt_pl.estimation.robust import robust_deviation
from idapt_pl.modules import ActionTransformation
from idapt_pl.tasks import Task

log = logging.getLogger(__name__)
CLEARLY_BETTER = 1.5
"""A law is preferred to a simpler one if the simpler one leaves this many times as much on held-out episodes."""

STATE_STEP, PARAMETER_STEP = 1e-4, 1e-3
"""Steps of the differences by first states and by parameters."""
MOST_MOVE, MOST_KICK = 0.05, 1.0
"""What a step changes first positions (m or rad) and velocities (per second) by at most."""

ActionLaw = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""(parameters (p,), states (n, state_dim), target actions (n, nu)) to source actions (n, nu)."""


@dataclass(frozen=True)
class MatchingWindows:
    """Windows of what was seen of the target: positions (n, H+1, nq) and the actions between them (n, H, nu)."""

    qpos: np.ndarray
    actions: np.ndarray
    episode: np.ndarray

    def part(self, rows: np.ndarray) -> MatchingWindows:
        """Some of the windows."""
        return MatchingWindows(self.qpos[rows], self.actions[rows], self.episode[rows])


@dataclass(frozen=True)
class WindowStarts:
    """First states of windows: positions (n, nq) and velocities (n, nv)."""

    qpos: np.ndarray
    qvel: np.ndarray

    def moved(self, by: np.ndarray) -> WindowStarts:
        """Moved by (n, nq + nv), but not far in one step."""
        nq = self.qpos.shape[1]
        return WindowStarts(
            self.qpos + np.clip(by[:, :nq], -MOST_MOVE, MOST_MOVE),
            self.qvel + np.clip(by[:, nq:], -MOST_KICK, MOST_KICK),
        )


def cut_windows(qpos: np.ndarray, actions: np.ndarray, first: np.ndarray, length: int, stride: int) -> MatchingWindows:
    """Cut what was seen of whole episodes into windows that do not cross an episode's end.

    Args:
        qpos: of every observation, (N, nq).
        actions: at every observation (anything at an episode's last), (N, nu).
        first: index of the first observation of each observation's episode, (N,).
        length: control steps in a window, H.
        stride: between the starts of windows.
    """
    starts = np.arange(0, len(qpos) - length, stride)
    starts = starts[first[starts] == first[starts + length]]
    if not len(starts):
        raise ValueError(f"no episode in the target lasts {length} control steps, which trajectory matching needs")
    return MatchingWindows(
        np.stack([qpos[starts + j] for j in range(length + 1)], 1).astype(float),
        np.stack([actions[starts + j] for j in range(length)], 1).astype(float),
        first[starts],
    )


class TrajectoryMatching:
    """Least squares over parameters of an action law; every window's first state is free and projected out.

    Args:
        task: gives the state vector and the control period.
        domain: the source.
        seen: what to match.
        act: the action law.
    """

    def __init__(self, task: Task, domain: Domain, seen: MatchingWindows, act: ActionLaw) -> None:
        self.task, self.domain, self.seen, self.act = task, domain, seen, act
        self.model = model = domain.compile()
        self.data = [mujoco.MjData(model) for _ in range(2)]
        self.each: list[mujoco.MjData] = []
        self.dt = task.period(model)
        # time, positions, velocities; then what actuators with a lag or delay remember, which is nothing yet
        self.rest = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, self.data[0], self.rest, mujoco.mjtState.mjSTATE_FULLPHYSICS)

    def replay(self, parameters: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Positions along every window, (n, (H+1) nq)."""
        m = self.model
        low, high = m.actuator_ctrlrange.T
        play = self.simulate_each if has_laws(m) else self.simulate_together
        x = np.repeat(self.rest[None], len(qpos), 0)
        x[:, 1 : 1 + m.nq + m.nv] = np.concatenate([qpos, qvel], 1)
        seen = [qpos]
        for j in range(self.seen.actions.shape[1]):
            states = x[:, 1 : 1 + m.nq + m.nv]
            u = np.clip(self.act(parameters, states, self.seen.actions[:, j]), low, high)
            x = play(x, self.domain.command(m, u))
            seen.append(x[:, 1 : 1 + m.nq])
        return np.stack(seen, 1).reshape(len(qpos), -1)

    def simulate_together(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """States (n, full physics) after a control step with commands (n, nu)."""
        substeps = self.task.frame_skip * self.task.action_repeat
        held = np.repeat(u[:, None], substeps, 1)
        after, _ = rollout.rollout(self.model, self.data, x, held, persistent_pool=True)
        return after[:, -1]

    def simulate_each(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The same one by one, where force laws act that MuJoCo does not know of."""
        if len(self.each) != len(x):
            self.each = [mujoco.MjData(self.model) for _ in x]
        after = np.empty_like(x)
        for data, before, command, now in zip(self.each, x, u, after, strict=True):
            mujoco.mj_setState(self.model, data, before, mujoco.mjtState.mjSTATE_FULLPHYSICS)
            mujoco.mj_forward(self.model, data)
            for _ in range(self.task.action_repeat):
                self.task.play(self.model, data, command)
            mujoco.mj_getState(self.model, data, now, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        return after

    def fit(
        self, parameters: np.ndarray, free: np.ndarray, ridge: float, iterations: int = 8
    ) -> tuple[np.ndarray, float]:
        """Gauss-Newton with Huber weights over the parameters with the indices ``free``; none scores them as they are.

        What first states could explain is projected out of the residuals, whose robust scale is measured anew in every
        iteration; then the first states follow.

        Returns:
            The parameters and the robust scale of what is left, m or rad.
        """
        p, starts, scale = parameters.astype(float).copy(), self.seen_starts(), 1.0
        for _ in range(iterations):
            left, S, J = self.linearise(p, free, starts)
            Q = np.linalg.qr(S)[0]
            r, K = project_out(Q, left[..., None]), project_out(Q, J)
            scale = float(robust_deviation(r.ravel()))
            weighted = K * (huber_weights(r, 3 * scale) / scale**2)
            H, g = np.einsum("nij,nik->jk", weighted, K), np.einsum("nij,ni->j", weighted, r[..., 0])
            move = np.linalg.solve(H + ridge * np.eye(len(free)), g - ridge * p[free])
            p[free] += move
            starts = starts.moved(np.einsum("nij,nj->ni", np.linalg.pinv(S), left - J @ move))
        return p, scale

    def seen_starts(self) -> WindowStarts:
        """First states of all windows as they were seen, velocities as differences of positions."""
        qpos = self.seen.qpos
        return WindowStarts(qpos[:, 0].copy(), (qpos[:, 1] - qpos[:, 0]) / self.dt)

    def linearise(
        self, p: np.ndarray, free: np.ndarray, starts: WindowStarts
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What a replay leaves, and how the replay depends on first states and free parameters, by differences.

        Returns:
            Seen minus replayed positions (n, (H+1) nq), their slopes in first states (n, (H+1) nq, nq + nv) and in the
            free parameters (n, (H+1) nq, free).
        """
        base = self.replay(p, starts.qpos, starts.qvel)
        nq = starts.qpos.shape[1]
        of_state, of_p = STATE_STEP * np.eye(nq + starts.qvel.shape[1]), PARAMETER_STEP * np.eye(len(p))[free]
        S = [(self.replay(p, starts.qpos + s[:nq], starts.qvel + s[nq:]) - base) / STATE_STEP for s in of_state]
        J = [(self.replay(p + s, starts.qpos, starts.qvel) - base) / PARAMETER_STEP for s in of_p]
        left = self.seen.qpos.reshape(len(base), -1) - base
        return left, np.stack(S, -1), np.stack(J, -1) if J else np.zeros((*base.shape, 0))


@dataclass(frozen=True)
class MatchingProblem:
    """Trajectory matching with F's affine part as the action law.

    Attributes:
        match: windows to what matches them.
        seen: all windows.
        laws: indices of the free parameters of each law: none, of the actions, of positions too, of velocities too.
        size: number of parameters.
    """

    match: Callable[[MatchingWindows], TrajectoryMatching]
    seen: MatchingWindows
    laws: tuple[np.ndarray, ...]
    size: int

    def halves(self) -> tuple[TrajectoryMatching, TrajectoryMatching]:
        """Every other episode to fit to, and the rest, held out."""
        odd = np.unique(self.seen.episode, return_inverse=True)[1] % 2 == 1
        if not odd.any():  # one long episode
            odd[len(odd) // 2 :] = True
        return self.match(self.seen.part(~odd)), self.match(self.seen.part(odd))

    def compare(self, ridge: float) -> tuple[list[np.ndarray], list[float]]:
        """Parameters of every law, fitted to one half, and the robust scale of what each leaves of the other."""
        fit, held_out = self.halves()
        zero = np.zeros(self.size)
        fitted = [fit.fit(zero, law, ridge)[0] if law.size else zero for law in self.laws]
        return fitted, [held_out.fit(p, np.zeros(0, int), ridge, 3)[1] for p in fitted]

    def simplest_predictive_law(self, ridge: float) -> tuple[np.ndarray, float]:
        """The simplest law that predicts well.

        Estimated velocities are noisy and, where things fall, proportional to positions; a law that may use both
        trades one for the other, and is wrong wherever they part. What a law leaves is mostly systematic errors of the
        estimates, which more coefficients explain a little of, on held-out episodes too: a larger law must be clearly
        better.

        Returns:
            Parameters (nu * (nq + nv + nu + 1),), refitted on all windows, and the robust scale of what is left, m or
            rad.
        """
        fitted, scores = self.compare(ridge)
        best = next(i for i, score in enumerate(scores) if score <= CLEARLY_BETTER * min(scores))
        left = np.round(scores, 6).tolist()
        log.info("what laws of nothing, actions, positions, velocities leave on held-out episodes: %s", left)
        return self.match(self.seen).fit(fitted[best], self.laws[best], ridge, 4)


def matching_problem(
    F: ActionTransformation,
    task: Task,
    domain: Domain,
    states: Tensor,
    actions: Tensor,
    first: np.ndarray,
    length: int = 5,
) -> MatchingProblem:
    """Windows of estimated target states, to be matched by the source with F's affine part.

    Args:
        F: the action transformation; its features must be standardised states (``encoder: supervised``).
        task: the task, whose state must be its positions followed by its velocities.
        domain: the source.
        states: estimated from the target's images, in units, (N, state_dim).
        actions: (N, nu).
        first: index of the first observation of each observation's episode.
        length: control steps in a window.

    Raises:
        ValueError: if the state is another one, or no episode is long enough.
    """
    model = domain.compile()
    if model.nq + model.nv != states.shape[1]:
        raise ValueError(f"trajectory matching needs a state of positions and velocities; {task.name} has another one")
    nu = len(F.low)

    def law(parameters: np.ndarray, state: np.ndarray, action: np.ndarray) -> np.ndarray:
        a = torch.from_numpy(action).float()
        x = F.agent_input((torch.from_numpy(state).float() - F.encoder.mean) / F.encoder.std, a)
        weights = torch.from_numpy(parameters).float().view(nu, -1)
        return F.apply_residual(a, x @ weights[:, :-1].T + weights[:, -1]).double().numpy()

    seen = cut_windows(states[:, : model.nq].numpy(), actions.numpy(), first, length, stride=max(1, length // 2))
    columns = np.arange(nu * (model.nq + model.nv + nu + 1)).reshape(nu, -1)
    position, _, action = np.split(columns[:, :-1], [model.nq, model.nq + model.nv], 1)
    base = np.concatenate([action, columns[:, -1:]], 1)
    laws = (np.zeros(0, int), base.ravel(), np.concatenate([base, position], 1).ravel(), columns.ravel())
    return MatchingProblem(lambda part: TrajectoryMatching(task, domain, part, law), seen, laws, columns.size)


@torch.no_grad()
def initialise_by_matching(
    F: ActionTransformation,
    task: Task,
    domain: Domain,
    states: Tensor,
    actions: Tensor,
    first: np.ndarray,
    ridge: float,
) -> float:
    """Set F's affine part by trajectory matching on estimated target states. Returns the robust remainder, m or rad.

    Arguments and errors are of :func:`matching_problem`; ``ridge`` is the weight of the squared coefficients, against
    the noise of the estimates.
    """
    problem = matching_problem(F, task, domain, states, actions, first)
    fitted, left = problem.simplest_predictive_law(ridge)
    weights = torch.from_numpy(fitted).float().view(len(F.low), -1)
    F.affine.weight.copy_(weights[:, :-1])
    F.affine.bias.copy_(weights[:, -1])
    return left


@torch.no_grad()
def held_out_remainders(
    F: ActionTransformation,
    task: Task,
    domain: Domain,
    states: Tensor,
    actions: Tensor,
    first: np.ndarray,
    ridge: float,
) -> list[float]:
    """What every law leaves of held-out episodes, m or rad; the first is that of the actions as they are."""
    return matching_problem(F, task, domain, states, actions, first).compare(ridge)[1]
