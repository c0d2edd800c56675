"""Write the recordings: ``python -m benchmarks.undeclared.generate --out DIR [--cases NAME ...] [--seeds 0 1 2]``.

``--table`` prints how much each hidden effect matters instead; see :func:`effect_size`.
"""

from __future__ import annotations

import argparse
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.undeclared.cases import CASES, SAME, Case, Numerics
from benchmarks.undeclared.hidden import PLAY, Sensor
from benchmarks.undeclared.models import MODELS, Model, Noise, nominal_xml
from datamodules.trajectories import Episode, Trajectories, write_trajectories

KINDS = ("multisine", "hold", "chirp", "low")  # excitation, by turns


@dataclass(frozen=True)
class Recording:
    """One episode as it was and as it was measured.

    Attributes:
        actions: commands before anything hidden happens to them, float32 (T, nu).
        clean: what faultless electronics behind the (possibly wrong) sensors would show, (T+1, nq + nv).
        measured: the same with noise, (T+1, nq + nv).
    """

    actions: np.ndarray
    clean: np.ndarray
    measured: np.ndarray


def generate(case: Case, seed: int, folder: Path) -> tuple[Path, Path]:
    """Write ``folder/nominal.xml`` and ``folder/measured.h5`` and return both paths; repeatable by seed."""
    folder.mkdir(parents=True, exist_ok=True)
    nominal, measured = folder / "nominal.xml", folder / "measured.h5"
    nominal.write_text(nominal_xml(case.model))
    model = mujoco.MjModel.from_xml_path(str(nominal))
    episodes = tuple(
        Episode(r.actions, {"qpos": r.measured[:, : model.nq], "qvel": r.measured[:, model.nq :]})
        for r in simulate(case, seed)
    )
    write_trajectories(measured, Trajectories(episodes, control_period(case.model), f"a recording of {case.model}"))
    return nominal, measured


def control_period(name: str) -> float:
    """Seconds from one command to the next."""
    return MODELS[name].frame_skip * _compile(name, SAME).opt.timestep


def simulate(case: Case, seed: int) -> list[Recording]:
    """The episodes of a case, from its true world."""
    rng = np.random.default_rng([seed, zlib.crc32(case.name.encode())])
    episodes = MODELS[case.model].episodes
    return [_Episode(case, KINDS[i % len(KINDS)], rng).record() for i in range(episodes)]


def true_model(case: Case) -> mujoco.MjModel:
    """The nominal MJCF with the case's edits and numerics."""
    return _compile(case.model, case.numerics, case)


def _compile(name: str, numerics: Numerics, case: Case | None = None) -> mujoco.MjModel:
    root = ET.fromstring(nominal_xml(name))
    for part in case.parts if case else ():
        if part.edit:
            part.edit(root)
    option = root.find("option")
    option.set("timestep", repr(float(option.get("timestep")) / numerics.divide))
    if numerics.integrator:
        option.set("integrator", numerics.integrator)
    return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))


def first_episodes(case: Case, kinds: tuple[str, ...], seed: int) -> list[Recording]:
    """An episode of each of these kinds of excitation."""
    rng = np.random.default_rng([seed, zlib.crc32(case.name.encode())])
    return [_Episode(case, kind, rng).record() for kind in kinds]


def replay(case: Case, commands: np.ndarray, rng: np.random.Generator, start: np.ndarray | None = None) -> Recording:
    """What the true world of a case does with commands (T, nu), in open loop and from rest.

    Args:
        case: what is hidden.
        commands: held for a control period each.
        rng: of the sensors' noise, and of the start if none is given.
        start: true positions of the nominal joints, (nq,).
    """
    episode = _Episode(case, "low", rng)
    episode.steps, episode.excitation, episode.balanced = len(commands), commands, False
    episode.noise = sensor_noise(len(commands) + 1, episode.nominal, case.noise, rng)
    if start is not None:
        episode.put(start, np.zeros(episode.nominal.nv))
    return episode.record()


class _Episode:
    """One episode in the true world: an explicit loop over physics steps."""

    def __init__(self, case: Case, kind: str, rng: np.random.Generator) -> None:
        self.case, self.settings, self.rng = case, MODELS[case.model], rng
        self.nominal = _compile(case.model, SAME)
        self.model = true_model(case)
        self.data = mujoco.MjData(self.model)
        self.forces = [p.force(self.model) for p in case.parts if p.force]
        self.commands = [p.command(self.model) for p in case.parts if p.command]
        self.sensors = [p.sensor(self.nominal) for p in case.parts if p.sensor]
        if self.commands:
            self.model.actuator_ctrllimited[:] = 0  # a recorded command is within range; the changed one may not be
        self.substeps = self.settings.frame_skip * case.numerics.divide
        delays = [p.sensor_delay / self.model.opt.timestep for p in case.parts]
        self.late = round(sum(delays))  # physics steps
        assert abs(self.late - sum(delays)) < 1e-6, "a delay must be a multiple of the true time step"
        self.steps = int(rng.integers(*self.settings.steps, endpoint=True))
        self.excitation = excitation(kind, self.steps, self.nominal, self.settings, case.amplitude, rng)
        self.balanced = kind != "low" or not self.settings.falls
        self.noise = sensor_noise(self.steps + 1, self.nominal, case.noise, rng)  # of coordinates that only add
        self.read = _reader(self.nominal, self.model, self.sensors)
        self.start()

    def start(self) -> None:
        low, high = np.array(self.settings.start).T
        speed = self.settings.start_speed
        qpos, qvel = self.rng.uniform(low, high), self.rng.uniform(-speed, speed, self.nominal.nv)
        if self.settings.spin:
            qvel[3:] = self.rng.uniform(-self.settings.spin, self.settings.spin, self.nominal.nv - 3)
            qpos[3:] = self.rng.normal(size=4)
            qpos[3:] /= np.linalg.norm(qpos[3:])
        if self.case.still:
            qpos, qvel = (low + high) / 2, np.zeros(self.nominal.nv)
        self.put(qpos, qvel)

    def put(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        coordinates, speeds = _addresses(self.nominal, self.model)
        self.data.qpos[coordinates], self.data.qvel[speeds] = qpos, qvel

    def record(self) -> Recording:
        past = [self.read(self.data)] * (self.late + 1)  # the last of them, oldest first
        actions, clean, measured = [], [], []
        for k in range(self.steps + 1):
            clean.append(past[0])
            measured.append(self.measure(past[0], k))
            if k == self.steps or self.fallen():
                break
            actions.append(self.command(k, measured[-1]))
            for _ in range(self.substeps):
                self.step(actions[-1].astype(float))
                past = [*past[1:], self.read(self.data)]
        return Recording(np.array(actions), np.array(clean), np.array(measured))

    def measure(self, clean: np.ndarray, k: int) -> np.ndarray:
        nq, nv, quantum, seen = self.nominal.nq, self.nominal.nv, self.case.noise.quantum, clean.copy()
        mujoco.mj_integratePos(self.nominal, seen[:nq], self.noise[k, :nv], 1.0)
        seen[nq:] += self.noise[k, nv:]
        if quantum:
            seen[:nq] = quantum * np.round(seen[:nq] / quantum)
        return seen

    def fallen(self) -> bool:
        if self.settings.fallen is None:
            return False
        coordinate, limit = self.settings.fallen
        return abs(self.data.qpos[coordinate]) > limit

    def command(self, k: int, measured: np.ndarray) -> np.ndarray:
        command = self.excitation[k]
        if self.settings.feedback is not None and self.balanced:
            command = command + np.array(self.settings.feedback) @ measured
        return np.clip(command, *self.nominal.actuator_ctrlrange.T).astype(np.float32)

    def step(self, command: np.ndarray) -> None:
        for transform in self.commands:
            command = transform(command, self.data.time)
        self.data.ctrl[:] = command
        self.data.qfrc_applied[:] = 0.0
        self.data.xfrc_applied[:] = 0.0
        for force in self.forces:
            force(self.model, self.data)
        mujoco.mj_step(self.model, self.data)


def _reader(
    nominal: mujoco.MjModel, true: mujoco.MjModel, sensors: list[Sensor]
) -> Callable[[mujoco.MjData], np.ndarray]:
    """Reads the nominal joints out of the true world, through the hidden sensors: (nq + nv,)."""
    names = [nominal.joint(j).name for j in range(nominal.njnt)]
    coordinates, speeds = _addresses(nominal, true)
    play = [(j, true.joint(name + PLAY).id) for j, name in enumerate(names) if _has_joint(true, name + PLAY)]

    def read(data: mujoco.MjData) -> np.ndarray:
        qpos, qvel = data.qpos[coordinates], data.qvel[speeds]
        for j, extra in play:
            qpos[j] += data.qpos[true.jnt_qposadr[extra]]
            qvel[j] += data.qvel[true.jnt_dofadr[extra]]
        for sensor in sensors:
            sensor(qpos, qvel)
        return np.concatenate([qpos, qvel])

    return read


def _addresses(nominal: mujoco.MjModel, true: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Where the true world has the coordinates and velocities of the nominal joints, (nq,) and (nv,)."""
    joints = [true.joint(nominal.joint(j).name) for j in range(nominal.njnt)]
    sizes = [(7, 6) if joint.type[0] == mujoco.mjtJoint.mjJNT_FREE else (1, 1) for joint in joints]
    at = [
        np.concatenate([adr + np.arange(size[i]) for adr, size in zip(begin, sizes, strict=True)])
        for i, begin in enumerate(([j.qposadr[0] for j in joints], [j.dofadr[0] for j in joints]))
    ]
    return at[0], at[1]


def _has_joint(model: mujoco.MjModel, name: str) -> bool:
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) >= 0


def excitation(
    kind: str, steps: int, nominal: mujoco.MjModel, settings: Model, factor: float, rng: np.random.Generator
) -> np.ndarray:
    """Commands of one episode, (steps, nu).

    ``multisine`` is five sines an actuator, ``chirp`` a sweep, ``hold`` random levels held for random times, and
    ``low`` a multisine of a quarter of the amplitude.
    """
    dt = settings.frame_skip * nominal.opt.timestep
    t = dt * np.arange(steps)[:, None]
    phase = rng.uniform(0, 2 * np.pi, (5, nominal.nu))
    slow, fast = 1.5 / (steps * dt), min(0.15 / dt, settings.fastest)  # Hz
    if kind in ("multisine", "low"):
        frequency = rng.uniform(slow, fast, (5, nominal.nu))
        signal = np.sin(2 * np.pi * frequency * t[:, None] + phase).sum(axis=1)
        signal /= np.abs(signal).max(axis=0)
    elif kind == "chirp":
        sweep = slow * t + (fast - slow) * t**2 / (2 * steps * dt)
        signal = np.sin(2 * np.pi * sweep + phase[0])
    else:
        signal = np.empty((steps, nominal.nu))
        for i in range(nominal.nu):
            lengths = rng.integers(2, 12, steps)
            signal[:, i] = np.repeat(rng.uniform(-1, 1, steps), lengths)[:steps]
    loudness = rng.uniform(0.7, 1.0) * (0.25 if kind == "low" else 1.0) * factor
    return loudness * np.array(settings.amplitude) * signal


def sensor_noise(rows: int, nominal: mujoco.MjModel, noise: Noise, rng: np.random.Generator) -> np.ndarray:
    """White or AR(1) noise of the stated standard deviation, (rows, nv + nv); of rotations it is a vector."""
    white = rng.standard_normal((rows, nominal.nv + nominal.nv))
    for k in range(1, rows):
        white[k] = noise.correlation * white[k - 1] + np.sqrt(1 - noise.correlation**2) * white[k]
    return white * _std(nominal, noise)


def _std(nominal: mujoco.MjModel, noise: Noise) -> np.ndarray:
    return np.repeat([noise.qpos, noise.qvel], nominal.nv)


def _difference(model: mujoco.MjModel, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """One state minus another, (nq + nv,) each, as (nv + nv,)."""
    apart, nq = np.zeros(model.nv), model.nq
    mujoco.mj_differentiatePos(model, apart, 1.0, other[:nq], one[:nq])
    return np.concatenate([apart, one[nq:] - other[nq:]])


@dataclass(frozen=True)
class EffectSize:
    """How far the nominal model's short predictions are from the truth, in sensor-noise standard deviations.

    Attributes:
        rms: over all windows and channels; the nominal model runs with the true numerics, so only the effect counts.
        channel: the same of the channel that shows most.
        median: of the windows' rms.
        numerics: rms between the nominal model and itself with the true numerics.
        noise: rms that the noise of the initial state alone makes in a prediction.
        seconds: of data.
    """

    rms: float
    channel: float
    median: float
    numerics: float
    noise: float
    seconds: float


def effect_size(case: Case, seed: int = 0, horizon: int = 5, stride: int = 4) -> EffectSize:
    """Compare the recorded truth with the nominal model's prediction over ``horizon`` control steps, without noise."""
    recordings = simulate(case, seed)
    rng = np.random.default_rng(seed)
    skip = MODELS[case.model].frame_skip
    nominal, same = _compile(case.model, SAME), _compile(case.model, case.numerics)
    std = _std(nominal, case.noise)
    effect, numerics, noise = [], [], []
    for r in recordings:
        for k in range(0, len(r.actions) - horizon + 1, stride):
            actions = r.actions[k : k + horizon].astype(float)
            ideal = _predict(same, r.clean[k], actions, skip * case.numerics.divide)
            plain = _predict(nominal, r.clean[k], actions, skip)
            start, moved = r.clean[k].copy(), std * rng.standard_normal(len(std))
            mujoco.mj_integratePos(nominal, start[: nominal.nq], moved[: nominal.nv], 1.0)
            start[nominal.nq :] += moved[nominal.nv :]
            noisy = _predict(nominal, start, actions, skip)
            effect.append(_difference(nominal, ideal, r.clean[k + horizon]) / std)
            numerics.append(_difference(nominal, ideal, plain) / std)
            noise.append(_difference(nominal, noisy, plain) / std)
    rms = lambda x, axis=None: np.sqrt(np.mean(np.square(x), axis=axis))  # noqa: E731
    seconds = sum(len(r.actions) for r in recordings) * control_period(case.model)
    return EffectSize(rms(effect), rms(effect, 0).max(), np.median(rms(effect, 1)), rms(numerics), rms(noise), seconds)


def _predict(model: mujoco.MjModel, state: np.ndarray, actions: np.ndarray, substeps: int) -> np.ndarray:
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = state[: model.nq], state[model.nq :]
    for action in actions:
        data.ctrl[:] = action
        mujoco.mj_step(model, data, substeps)
    return np.concatenate([data.qpos, data.qvel])


def main(argv: list[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="writes OUT/<case>/seed<k>/{nominal.xml,measured.h5}")
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=CASES, metavar="NAME")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--table", action="store_true", help="print effect sizes for the first seed")
    args = parser.parse_args(argv)
    if not (args.table or args.out):
        parser.error("nothing to do: give --out DIR or --table")
    if args.table:
        print(f"{'case':30s} {'kind':10s}   size channel  median numerics  noise  data s")
        for name in args.cases:
            e = effect_size(CASES[name], args.seeds[0])
            row = f"{e.rms:7.2f} {e.channel:7.2f} {e.median:7.2f} {e.numerics:8.2f} {e.noise:6.2f} {e.seconds:7.1f}"
            print(f"{name:30s} {CASES[name].kind:10s} {row}", flush=True)
    if args.out:
        for name in args.cases:
            for seed in args.seeds:
                generate(CASES[name], seed, args.out / name / f"seed{seed}")


if __name__ == "__main__":
    main()
