"""What each explanation says a motion will do, from the start pose on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.effects.world import Numerics
from idapt_pl.excitation.limits import ImpossibleMotion
from idapt_pl.excitation.rivals import Rival
from idapt_pl.prediction.data import Recording, Windows
from idapt_pl.prediction.simulator import Effects, Simulator

SETTLING = 3.0
"""Seconds for which the start pose is held before a motion begins."""

AT_REST = 0.2
"""Greatest speed after that, rad/s or m/s."""


@dataclass(frozen=True)
class Forecast:
    """Predicted measurements of motions.

    Attributes:
        time: s, (T+1,).
        qpos: (n, T+1, nq).
        qvel: (n, T+1, nv).
        states: of the explanation's own model meanwhile, ``mjSTATE_FULLPHYSICS``, (n, T+1, size).
        arriving: what reaches the actuators from then on, through all that happens to commands, (n, T+1, nu).
    """

    time: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    states: np.ndarray
    arriving: np.ndarray

    def recordings(self, commands: np.ndarray) -> list[Recording]:
        """As if they had been measured without noise; ``commands`` are (n, T, nu)."""
        rows = zip(self.qpos, self.qvel, commands, strict=True)
        return [Recording(f"motion_{i}", self.time, q, v, u) for i, (q, v, u) in enumerate(rows)]


class MotionForecaster:
    """Simulates commands from a start pose under any explanation.

    Args:
        spec: the model before repair.
        rivals: the explanations.
        qpos: start pose, (nq,).
        held: commands that hold it, (nu,).
        control_period: s.
        velocities: whether they are measured.
        threads: for simulating.
        unmeasured: names of joints that nothing is judged by.

    Raises:
        ImpossibleMotion: the model does not stay at the start pose.
    """

    def __init__(
        self, spec: mujoco.MjSpec, rivals: Sequence[Rival], qpos: np.ndarray, held: np.ndarray, control_period: float,
        velocities: bool, threads: int | None = None, unmeasured: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.dt, self.held, self.rivals = control_period, held, rivals
        nothing = np.zeros(spec.copy().compile().nv)
        still = Recording("start", control_period * np.arange(2), np.tile(qpos, (2, 1)), np.tile(nothing, (2, 1)),
                          held[None])  # fmt: skip
        self.sim = Simulator(spec, [still], velocities, threads, unmeasured)
        self.sim.kept_models = 64
        self.model = self.sim.model
        self._starts: dict[Effects, np.ndarray] = {}
        self.given = qpos
        for rival in rivals:
            self.start(coarse(rival))

    @property
    def rest(self) -> np.ndarray:
        """Where the leading explanation's model is at rest while the start's commands are held, (nq,)."""
        return self.start(coarse(self.rivals[0])) if self.rivals else self.given

    def start(self, effects: Effects) -> np.ndarray:
        """Where a model is at rest while the start's commands are held, as measured, (nq,)."""
        if effects not in self._starts:
            steps = max(1, round(SETTLING / self.dt))
            seen = self._play(effects, np.tile(self.held, (1, steps, 1)), self.given)
            speed = np.abs(seen.qvel[0, -1])
            if not np.isfinite(seen.qpos).all() or speed.max() > AT_REST:
                moving = self.sim.channels[int(np.nan_to_num(speed, nan=np.inf).argmax())]
                raise ImpossibleMotion(
                    f"the model does not rest at the start pose: after {SETTLING:g} s with constant commands {moving} "
                    f"moves at {speed.max():.2g} per second; give a pose that it holds, --start"
                )
            self._starts[effects] = seen.qpos[0, -1]
        return self._starts[effects]

    def __call__(self, effects: Effects, commands: np.ndarray, start: np.ndarray | None = None) -> Forecast:
        """What is measured while commands (n, T, nu) are played; ``start`` (nq,) in place of the model's own rest."""
        return self._play(effects, commands, self.start(effects) if start is None else start)

    def _play(self, effects: Effects, commands: np.ndarray, qpos: np.ndarray) -> Forecast:
        n, steps, _ = commands.shape
        time, still = self.dt * np.arange(steps + 1), np.zeros((steps + 1, self.model.nv))
        at = np.tile(qpos, (steps + 1, 1))
        sim = self.sim.replaying([Recording(f"motion_{i}", time, at, still, u) for i, u in enumerate(commands)])
        whole = Windows(np.arange(n), np.zeros(n, int), np.arange(1, steps + 1))
        states, arriving = sim.states(effects, whole)
        q, v = sim.seen(effects, whole, states)
        first = np.broadcast_to(qpos, (n, 1, len(qpos))), np.zeros((n, 1, self.model.nv))
        k = np.round(time / sim.compile(effects).opt.timestep).astype(int)
        return Forecast(
            time, np.concatenate([first[0], q], 1), np.concatenate([first[1], v], 1), states[:, k],
            arriving[:, np.minimum(k, arriving.shape[1] - 1)],
        )  # fmt: skip


def coarse(rival: Rival) -> Effects:
    """The effects of an explanation without a time step and an integrator that were found: quicker, and the same for
    all explanations.
    """
    return tuple(e for e in rival.effects if not isinstance(e, Numerics))
