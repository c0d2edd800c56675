"""Other fits of a model to recordings, on the windows of a diagnosis: by hand, of PACE, and with mujoco.sysid.

All start from the windows and the noise that a diagnosis has chosen, and are judged as it is, on held-out windows. None
names a cause.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import cma
import mujoco
import numpy as np

from idapt_pl.diagnosis.candidates.fit import effects_of, parameter_box
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.runtime import RuntimeEffect
from idapt_pl.estimation.least_squares import robust_loss
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.simulator import Simulator, silence_mujoco
from idapt_pl.prediction.whitening import whiten

BY_HAND = ("joint_damping", "joint_frictionloss", "joint_armature")
OF_PACE = (*BY_HAND, "sensor_bias", "actuator_delay")
"""Bjelonic et al. (arXiv 2509.06342): rotor inertia, damping, friction and bias of every joint, and one delay."""

WIDEST = 20.0
"""Bounds of the parameters, in noticeable changes."""


def held_out_error(state: SearchState, residual: np.ndarray) -> float:
    """Rms of the whitened held-out error, as in report.json."""
    return float(np.sqrt(robust_loss(whiten(state.windows.held_out.W, residual)).mean()))


# --- by hand, and PACE ----------------------------------------------------------------------------


def of_each_joint(context: SearchContext, kinds: Sequence[str]) -> list[Candidate]:
    """Candidates of these kinds for every joint of its own, of delays the one for all actuators."""
    single = [c for c in context.candidates if c.kind.name in kinds and c.target not in ("*", "actuated")]
    of_joints = [c for c in single if c.kind.name != "actuator_delay"]
    delays = [c for c in context.candidates if c.kind.name == "actuator_delay" and "actuator_delay" in kinds]
    common = [c for c in delays if c.target == "*"] or delays[:1]  # a single actuator has none for all
    return [*of_joints, *common]


def by_hand(context: SearchContext, state: SearchState, steps: int = 15) -> float:
    """Held-out error after damping, friction and rotor inertia of every joint were fitted at once, by least squares."""
    windows, candidates = state.windows, of_each_joint(context, BY_HAND)
    start = [np.array(c.nominal, float) for c in candidates]
    x = context.fit(windows.fit, context.declared, candidates, start, steps).x
    loss = context.loss(windows.held_out, (*context.declared, *effects_of(candidates, x)))
    return float(np.sqrt(loss.mean()))


def pace(context: SearchContext, state: SearchState, simulations: int = 3000, seed: int = 0) -> float:
    """Held-out error after CMA-ES has fitted what PACE fits."""
    windows, candidates = state.windows, of_each_joint(context, OF_PACE)
    box = parameter_box(candidates)
    nominal = np.concatenate([c.nominal for c in candidates])
    ends = np.cumsum([c.size for c in candidates])[:-1]

    def effects(z: np.ndarray) -> tuple:
        return (*context.declared, *effects_of(candidates, np.split(nominal + z * box.scale, ends)))

    low = np.maximum((box.low - nominal) / box.scale, -WIDEST)
    high = np.minimum((box.high - nominal) / box.scale, WIDEST)
    start = np.clip(np.ones(len(nominal)), low, high)
    options = {"bounds": [low, high], "seed": seed + 1, "maxfevals": simulations, "verbose": -9, "tolfun": 1e-4}
    best = cma.CMAEvolutionStrategy(start, 1.0, options)
    best.optimize(lambda z: float(context.loss(windows.fit, effects(np.asarray(z))).mean()))
    return float(np.sqrt(context.loss(windows.held_out, effects(np.asarray(best.result.xbest))).mean()))


# --- mujoco.sysid ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SysidFit:
    """What mujoco.sysid came to.

    Attributes:
        parameters: what was fitted, an effect of one number each.
        change: of each, in noticeable changes, (p,).
        interval: half of its 95 % interval, (p,).
        after: held-out error.
    """

    parameters: Sequence[Candidate]
    change: np.ndarray
    interval: np.ndarray
    after: float


def single_numbers(context: SearchContext) -> list[Candidate]:
    """Effects that are one number of one element of the MJCF and add no state to it, each once."""
    plain = context.sim.model

    def fits(c: Candidate) -> bool:
        if c.size != 1 or c.target == "*" or issubclass(c.kind, RuntimeEffect):
            return False
        changed = context.sim.compile((c.effect(np.add(c.nominal, c.scale)),))
        return (changed.nq, changed.na) == (plain.nq, plain.na)

    return list({c.label: c for c in context.candidates if fits(c)}.values())


def sequences(spec: mujoco.MjSpec, sim: Simulator, windows: Windows):
    """Windows as mujoco.sysid takes them: held commands at every time step, positions and velocities as sensors."""
    from mujoco import sysid

    spec = spec.copy()
    for kind, suffix in ((mujoco.mjtSensor.mjSENS_JOINTPOS, "pos"), (mujoco.mjtSensor.mjSENS_JOINTVEL, "vel")):
        for joint in spec.joints:
            spec.add_sensor(
                name=f"{joint.name}_{suffix}", type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint.name
            )
    model = spec.copy().compile()
    h, states, controls, sensors = model.opt.timestep, [], [], []
    for e, start in zip(windows.episode, windows.start, strict=True):
        r, rows = sim.data[e], np.arange(start, start + windows.offsets[-1] + 1)
        times = r.time[rows] - r.time[start]
        grid = np.arange(round(times[-1] / h) + 2) * h  # the last one is dropped by its rollout
        held = np.clip(np.searchsorted(times, grid + 1e-9, side="right") - 1, 0, len(rows) - 2)
        states.append(sysid.create_initial_state(model, r.qpos[start], r.qvel[start], np.zeros(model.na)))
        controls.append(sysid.TimeSeries(grid, r.actions[rows[held]]))
        sensors.append(sysid.TimeSeries.from_names(times, np.hstack([r.qpos[rows], r.qvel[rows]]), model))
    names = [f"window_{i}" for i in range(len(windows))]
    return sysid.ModelSequences(spec.modelname or "model", spec, names, states, controls, sensors)


def sysid_fit(
    context: SearchContext, state: SearchState, w: Windows, spec: mujoco.MjSpec, optimizer: str, iterations: int
) -> SysidFit:
    """Fit all single numbers at once.

    Args:
        context: of a search.
        state: of that search; it is judged on its held-out windows.
        w: windows to fit.
        spec: of the nominal model.
        optimizer: of mujoco.sysid, ``mujoco`` or ``scipy``.
        iterations: of it, at most.
    """
    from mujoco import sysid

    sim, singles = context.sim, single_numbers(context)
    params = sysid.ParameterDict()
    for c in singles:
        # in units of what is noticeable: the fit stalls where units differ widely or bounds are far apart
        low, high = (float((b[0] - c.nominal[0]) / c.scale[0]) for b in c.bounds())
        apply = lambda s, p, c=c: c.effect(np.add(c.nominal, np.multiply(c.scale, p.value))).apply(s)  # noqa: E731
        params.add(sysid.Parameter(c.label, 0.0, max(low, -WIDEST), min(high, WIDEST), modifier=apply))
    measured = sequences(spec, sim, w)
    scale = np.sqrt(np.square(sim.residual(context.declared, w)).mean((0, 1)))

    def weighted(params, predicted, seen, model, return_all, state):
        """Residual at the samples' own times. The sensors of a rollout lag by a time step, its states do not."""
        at = seen.times[1:]
        values = np.stack([np.interp(at, state[:, 0], column) for column in state[:, 1 : 1 + model.nq + model.nv].T], 1)
        same = sysid.TimeSeries(at, values, seen.signal_mapping)
        return (seen.data[1:] - values) / scale, same, sysid.TimeSeries(at, seen.data[1:], seen.signal_mapping)

    # all windows of one vector of parameters at once: window by window its models would be compiled again for each
    measured.measured_rollout = [measured.measured_rollout]
    residual = sysid.build_residual_fn(
        models_sequences=[measured], modify_residual=weighted, resample_true=False,
        build_model=lambda p, spec: sysid.apply_param_modifiers(p, spec.copy()),  # else gains pile up
    )  # fmt: skip

    rows = len(w) * w.offsets[-1] * (sim.model.nq + sim.model.nv)

    def column(x: np.ndarray, params) -> np.ndarray:
        try:
            return np.nan_to_num(residual(x, params)[0][0], nan=1e3).clip(-1e3, 1e3)
        except ValueError:  # it cannot read a simulation that blew up, whose clock starts again
            return np.full(rows, 1e3)

    def columns(x: np.ndarray, params) -> tuple[list[np.ndarray], None, None]:
        vectors = x[:, None] if x.ndim == 1 else x
        found = np.stack([column(v, params) for v in vectors.T], 1)
        return [found[:, 0] if x.ndim == 1 else found], None, None

    with silence_mujoco():
        how = {"mujoco": {"eps": 0.02, "output": io.StringIO()}}.get(optimizer, {"diff_step": 0.02, "loss": "soft_l1"})
        fitted, result = sysid.optimize(params, columns, optimizer, verbose=False, max_iters=iterations, **how)
    change = fitted.as_vector()
    x = np.array([c.nominal[0] + c.scale[0] * v for c, v in zip(singles, change, strict=True)])
    _, interval = sysid.calculate_intervals(columns(change, params)[0], result.jac)
    left = context.loss(state.windows.held_out, (*context.declared, *effects_of(singles, x[:, None])))
    return SysidFit(singles, change, interval, float(np.sqrt(left.mean())))
