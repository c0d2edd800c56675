"""Predictions of measured windows by the model with some effects, many windows at once."""

from __future__ import annotations

import copy
import ctypes
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np

from idapt_pl.effects.base import PLAY_SUFFIX, Effect
from idapt_pl.effects.learned import SignalForce
from idapt_pl.effects.own_signals import own_signals, take_signals
from idapt_pl.effects.runtime import ForceEffect, RuntimeEffect, SensingEffect
from idapt_pl.effects.world import ExternalForce
from idapt_pl.prediction.activations import FirstActivations
from idapt_pl.prediction.applied_forces import AppliedForces
from idapt_pl.prediction.backlash import BacklashCoordinates
from idapt_pl.prediction.compiled_model import CompiledModel, for_motion_alone
from idapt_pl.prediction.data import Recording, Windows, position_difference, shift_positions
from idapt_pl.prediction.held_commands import HeldCommands
from idapt_pl.prediction.interpolation import interpolate_states
from idapt_pl.prediction.inverse_dynamics import lacking_at_states
from idapt_pl.prediction.law_history import LawsInWindows
from idapt_pl.prediction.model import without_textures
from idapt_pl.prediction.recent import RecentArrays
from idapt_pl.prediction.rolling import STATE, roll
from idapt_pl.prediction.side_by_side import SideBySide
from idapt_pl.usable_cores import usable_cores

Effects = tuple[Effect, ...]
Motion = tuple[np.ndarray, np.ndarray]
"""Positions and velocities."""
Sense = Callable[[np.ndarray, np.ndarray], Motion]
"""What a sensor makes of positions and velocities, or the other way round."""

SETTLING_SAMPLES = 8
"""Samples before a window from which it is found out where in their play joints are."""

KEPT_SAMPLES, KEPT_PREDICTIONS = 2**25, 2**27
"""Bytes: of recorded samples, and of predictions, of which many are asked for again in the next round of a search."""

FORCE_HOLD = 1e-3
"""Force laws that MJCF has no words for are evaluated so often at most [s], and held in between."""

LAW_HOLD = 2e-3
"""The same of learned laws, which are smooth [s]."""

DIRECTIONS = ("x", "y", "z", "about x", "about y", "about z")
"""In which a free joint moves, by the world's axes, and turns, by the body's; a ball joint has the last three."""

# A candidate may well be unstable: its prediction is then useless, which is all there is to say about it.
# A C function is called without Python's lock, so this is safe from the stepping threads.
_SILENCE = ctypes.CFUNCTYPE(ctypes.c_size_t, ctypes.c_char_p)(("strlen", ctypes.CDLL(None)))
_silenced: list[object] = []  # what handled warnings before, once for each that wants silence now
_silencing = threading.Lock()


@contextmanager
def silence_mujoco() -> Iterator[None]:
    """Keep MuJoCo's warnings about unstable simulations off the screen and out of its log file, in all threads."""
    with _silencing:
        _silenced.append(_silenced[-1] if _silenced else mujoco.get_mju_user_warning())
        mujoco.set_mju_user_warning(_SILENCE)
    try:
        yield
    finally:
        with _silencing:
            before = _silenced.pop()
            if not _silenced:
                mujoco.set_mju_user_warning(before)


class Simulator:
    """Replays windows from their first measured state.

    Delays and filters of the model's own actuators act on the commands, as found ones do. Predictions are read off at
    the samples' own times. What is asked for again is not simulated again. Several threads may ask at once
    (``side_by_side``).

    Args:
        spec: the nominal model.
        data: the recordings.
        velocities: compare velocities too (they were measured); else positions alone.
        threads: for stepping; default all cores that this process may use.
        unmeasured: names of joints, or ``"<joint> velocity"``, that are not compared: their recordings only say where
            to begin.
    """

    def __init__(
        self, spec: mujoco.MjSpec, data: list[Recording], velocities: bool, threads: int | None = None,
        unmeasured: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.spec, self.velocities = spec, velocities
        self._plain = without_textures(take_signals(spec)[0])
        self.model = self._plain.copy().compile()
        self.threads = threads or usable_cores()
        self.control_period = float(np.median(np.diff(data[0].time)))
        self.compared = np.array([not {n, n.split(" velocity")[0]} & {*unmeasured} for n in self.channels])
        self.side_by_side = SideBySide(self.threads)
        self.calls, self.kept_models = 0, 8 + 2 * self.threads
        self._record(data)
        self._compiled: dict[Effects, CompiledModel] = {}
        self._lock = threading.Lock()

    def replaying(self, data: list[Recording]) -> Simulator:
        """The same for other recordings; compiled models are shared."""
        twin = copy.copy(self)
        twin._record(data)
        return twin

    def _record(self, data: list[Recording]) -> None:
        """Recordings, and what is kept of them."""
        self.data, self.commands = data, HeldCommands(self.model, data, lambda step: own_signals(self.spec, step))
        self.activations = FirstActivations(self.model, data)
        self._samples = RecentArrays[np.ndarray](KEPT_SAMPLES)
        self._predictions = RecentArrays[Motion](KEPT_PREDICTIONS)

    @property
    def channels(self) -> list[str]:
        """Names of what residuals are of, at every sample; ``compared`` says which of them count."""
        m = self.model
        names: list[str] = []
        for j in range(m.njnt):
            kind, name = m.jnt_type[j], m.joint(j).name or f"joint {j}"
            size = {0: 6, 1: 3}.get(int(kind), 1)
            names += [name] if size == 1 else [f"{name} {axis}" for axis in DIRECTIONS[-size:]]
        return names + [f"{n} velocity" for n in names] * self.velocities

    def compile(self, effects: Effects) -> mujoco.MjModel:
        """The model with those effects that MJCF can say; command effects act on the commands instead."""
        return self._ready(effects).model

    def spec_with(self, effects: Sequence[Effect]) -> mujoco.MjSpec:
        """A copy of the model, without delays and filters of its own, with those effects that MJCF can say."""
        spec = self._plain.copy()
        for effect in effects:
            if not acts_outside_model(effect):
                effect.constrain(spec) if isinstance(effect, RuntimeEffect) else effect.apply(spec)
        return spec

    def _ready(self, effects: Effects) -> CompiledModel:
        """The model and room to simulate it; the last few are kept."""
        said = tuple(e for e in effects if not acts_outside_model(e))
        with self._lock:
            if (kept := self._compiled.get(said)) is not None:
                return kept
        made = CompiledModel(for_motion_alone(self.spec_with(said).compile()))
        with self._lock:
            if len(self._compiled) >= self.kept_models:
                self._compiled.pop(next(iter(self._compiled)))
            return self._compiled.setdefault(said, made)

    @property
    def _rooms(self) -> int:
        """In how many threads a batch of windows is simulated: in one where others are simulated beside it."""
        return 1 if self.side_by_side.within else self.threads

    def residual(
        self, effects: Effects, windows: Windows, nudge: np.ndarray | None = None, push: np.ndarray | None = None
    ) -> np.ndarray:
        """Measured minus predicted at every sample, (n, j, channels).

        Args:
            effects: the model's.
            windows: to compare.
            nudge: moves the first measured state, (2 nv,), for sensitivities.
            push: further forces, (n, k, nv), each for a k-th of the window.
        """
        return self.difference(self.measured(windows, windows.offsets), self.predict(effects, windows, nudge, push))

    def difference(self, one: Motion, other: Motion) -> np.ndarray:
        """One motion minus another, in all channels, (n, j, channels)."""
        parts = [position_difference(self.model, other[0], one[0])]
        if self.velocities:
            parts.append(one[1] - other[1])
        return np.nan_to_num(np.concatenate(parts, -1), nan=1e3, posinf=1e3, neginf=-1e3).clip(-1e3, 1e3)

    def predict(
        self, effects: Effects, windows: Windows, nudge: np.ndarray | None = None, push: np.ndarray | None = None
    ) -> Motion:
        """Predicted measurements at every sample: positions (n, j, nq) and velocities (n, j, nv)."""
        if push is not None:
            return self._simulate(effects, windows, nudge, push)
        moved = b"" if nudge is None else nudge.tobytes()
        key = (effects, windows.start.tobytes(), windows.episode.tobytes(), windows.offsets.tobytes(), moved)
        return self._predictions.get(key, lambda: self._simulate(effects, windows, nudge, None))

    def _simulate(
        self, effects: Effects, windows: Windows, nudge: np.ndarray | None, push: np.ndarray | None
    ) -> Motion:
        return self.seen(effects, windows, self.states(effects, windows, nudge, push)[0])

    def states(
        self, effects: Effects, windows: Windows, nudge: np.ndarray | None = None, push: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """True states, the first and that after every time step, (n, steps + 1, size), and commands (n, steps, nu).

        The latter as they reach the actuators in every time step. Arguments as of :meth:`residual`.
        """
        with self._lock:
            self.calls += 1
        ready = self._ready(effects)
        model = ready.model
        times, first = self.times(windows), self._start(effects, windows, nudge)
        steps = int(np.ceil((times[:, windows.offsets[-1]] - times[:, 0]).max() / model.opt.timestep - 1e-6))
        controls = self.commands.averaged(effects, windows, steps, model.opt.timestep)
        play = BacklashCoordinates(self.model, model)
        with silence_mujoco(), ready.room(self._rooms) as data:
            loose = self._settle(play, model, data, effects, windows) if play.size else np.zeros((len(windows), 2, 0))
            first = play.expand(*first, loose)
            return self._roll(model, data, effects, times[:, 0], *first, controls, windows, push), controls

    def seen(self, effects: Effects, windows: Windows, states: np.ndarray) -> Motion:
        """What is measured at every sample of windows in which a model goes through states (n, steps + 1, size)."""
        model, times = self.compile(effects), self.times(windows)
        ends = times[:, windows.offsets] - times[:, :1]
        qpos, qvel = BacklashCoordinates(self.model, model).contract(*interpolate_states(model, states, ends))
        for effect, joints in self._sensing(effects):
            qpos, qvel = self._sense(effect.measure, joints, qpos, qvel)
        return qpos, qvel

    def mean_states(self, effects: Effects, windows: Windows) -> np.ndarray:
        """Mean state in the control step in which windows begin, (n, size); rotations in the middle of it.

        Of models without play in joints.
        """
        ready = self._ready(effects)
        model = ready.model
        steps = max(1, round(self.control_period / model.opt.timestep))
        controls = self.commands.averaged(effects, windows, steps, model.opt.timestep)
        with silence_mujoco(), ready.room(self._rooms) as data:
            times = self.times(windows)[:, 0]
            states = self._roll(model, data, effects, times, *self._start(effects, windows), controls, windows)
        mean = states.mean(1)
        for adr, kind in zip(model.jnt_qposadr, model.jnt_type, strict=True):
            turning = 1 + adr + np.arange({0: 7, 1: 4}.get(int(kind), 0))
            mean[:, turning] = states[:, (steps + 1) // 2][:, turning]
        return mean

    def inverse_dynamics(
        self, effects: Effects, windows: Windows, states: np.ndarray, qacc: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Generalised forces that a model would need besides its own to accelerate so, (n, nv), and ``qacc``.

        Contacts and friction are as they would be under these accelerations.

        Args:
            effects: the model's, without play in joints.
            windows: n of them: commands are the mean of what arrives in the control step in which they begin.
            states: as of :meth:`mean_states`.
            qacc: (n, nv); default is what the model does by itself.
        """
        ready = self._ready(effects)
        model = ready.model
        controls = self.commands.averaged(effects, windows, 1, self.control_period)[:, 0]
        applied = np.zeros((len(states), model.nv + 6 * model.nbody))
        if any(isinstance(e, ForceEffect) for e in effects):
            self._applied(model, effects).add_to(applied, states)
            laws = LawsInWindows(model, self.model, effects, self.commands, windows)
            applied[:, : model.nv] += laws.forces(states, controls)
        with ready.room(1) as (data,):
            return lacking_at_states(model, data, states, controls, applied, qacc)

    def _start(self, effects: Effects, windows: Windows, nudge: np.ndarray | None = None) -> Motion:
        """True positions and velocities where windows begin, (n, nq) and (n, nv), as sensors with errors say."""
        qpos, qvel = (a[:, 0] for a in self.measured(windows, np.zeros(1, int)))
        if nudge is not None:
            nv = self.model.nv
            qpos, qvel = shift_positions(self.model, qpos, nudge[:nv]), qvel + nudge[nv:]
        for effect, joints in reversed(self._sensing(effects)):
            qpos, qvel = self._sense(effect.invert, joints, qpos, qvel)
        return qpos, qvel

    def _sensing(self, effects: Effects) -> list[tuple[SensingEffect, list[int]]]:
        """Errors of sensors, with the joints that they are of."""
        return [(e, self._joints(self.model, e.target)) for e in effects if isinstance(e, SensingEffect)]

    def times(self, windows: Windows) -> np.ndarray:
        """Times of the samples of every window, s, (n, samples)."""
        return self._of("time", windows, np.arange(windows.offsets[-1] + 1))

    def measured(self, windows: Windows, offsets: np.ndarray) -> Motion:
        """Measured positions and velocities at samples of every window, (n, offsets, nq) and (n, offsets, nv)."""
        return self._of("qpos", windows, offsets), self._of("qvel", windows, offsets)

    def _of(self, name: str, windows: Windows, offsets: np.ndarray) -> np.ndarray:
        """One channel of the recordings at samples of every window, (n, offsets, ...); the last few are kept."""
        pairs = zip(windows.episode, windows.start, strict=True)
        return self._samples.get(
            (name, windows.start.tobytes(), windows.episode.tobytes(), offsets.tobytes()),
            lambda: np.stack([getattr(self.data[e], name)[s + offsets] for e, s in pairs]),
        )

    def _joints(self, m: mujoco.MjModel, target: str) -> list[int]:
        scalar = [j for j in range(m.njnt) if m.jnt_type[j] >= 2 and not m.joint(j).name.endswith(PLAY_SUFFIX)]
        return [j for j in scalar if target in ("*", m.joint(j).name)]

    def _settle(
        self, play: BacklashCoordinates, model: mujoco.MjModel, data: list[mujoco.MjData], effects: Effects,
        windows: Windows,
    ) -> np.ndarray:  # fmt: skip
        """Where in their play joints are when windows begin, positions and velocities: (n, 2, joints with play).

        Nothing measures it. So the samples before are gone through: the link is put where it was measured at each of
        them, and what the motor does meanwhile decides which flank it rests on.
        """
        before = np.minimum(windows.start, SETTLING_SAMPLES)
        early = Windows(windows.episode, windows.start - before, np.zeros(1, int))
        per_sample = max(1, round(float(np.median(np.diff(self.times(windows)))) / model.opt.timestep))
        steps = int(before.max(initial=0)) * per_sample
        controls = self.commands.averaged(effects, early, steps, model.opt.timestep)
        loose = np.zeros((len(windows), 2, play.size))
        for k in range(int(before.max(initial=0))):
            rows = np.flatnonzero(k < before)
            at = Windows(early.episode[rows], early.start[rows] + k, np.zeros(1, int))
            time, qpos, qvel = (self._of(name, at, at.offsets)[:, 0] for name in ("time", "qpos", "qvel"))
            held = controls[rows, k * per_sample : (k + 1) * per_sample]
            states = self._roll(model, data, effects, time, *play.expand(qpos, qvel, loose[rows]), held, at)
            loose[rows] = play.read(states[:, -1, 1:])
        return loose

    def _sense(self, how: Sense, joints: list[int], qpos: np.ndarray, qvel: np.ndarray) -> Motion:
        qpos, qvel = qpos.copy(), qvel.copy()
        q, v = self.model.jnt_qposadr[joints], self.model.jnt_dofadr[joints]
        qpos[..., q], qvel[..., v] = how(qpos[..., q], qvel[..., v])
        return qpos, qvel

    def _roll(
        self, model: mujoco.MjModel, data: list[mujoco.MjData], effects: Effects, time: np.ndarray, qpos: np.ndarray,
        qvel: np.ndarray, controls: np.ndarray, windows: Windows, push: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """States after every step, the first one in front: (n, steps + 1, size)."""
        n, steps, _ = controls.shape
        start = np.zeros((n, mujoco.mj_stateSize(model, STATE)))
        start[:, 0], start[:, 1 : 1 + model.nq] = time, qpos
        start[:, 1 + model.nq : 1 + model.nq + model.nv] = qvel
        if model.na:
            start[:, 1 + model.nq + model.nv :][:, : model.na] = self.activations.at(controls[:, 0], windows)
        if push is not None:
            push = push[:, np.arange(steps) * push.shape[1] // steps]
        forces = [e for e in effects if isinstance(e, ForceEffect)]
        if not forces:
            return roll(model, data, start, controls, push)
        laws = LawsInWindows(model, self.model, effects, self.commands, windows)
        library = self._applied(model, effects)

        def forces_at(states: np.ndarray, commands: np.ndarray) -> np.ndarray:
            applied = np.zeros((n, model.nv + 6 * model.nbody))
            library.add_to(applied, states)
            applied[:, : model.nv] += laws.forces(states, commands)
            return applied

        hold = LAW_HOLD if all(isinstance(e, SignalForce) for e in forces) else FORCE_HOLD
        constant = all(isinstance(e, ExternalForce) for e in forces)
        held = None if constant else max(1, int(hold / model.opt.timestep + 1e-6))
        return roll(model, data, start, controls, push, forces_at, held)

    def _applied(self, model: mujoco.MjModel, effects: Effects) -> AppliedForces:
        """Force laws of the library."""
        return AppliedForces(model, effects, lambda target: self._joints(model, target))


def acts_outside_model(effect: Effect) -> bool:
    """Whether an effect acts on commands, forces or measurements alone, and needs nothing in the model."""
    return isinstance(effect, RuntimeEffect) and not effect.constrains
