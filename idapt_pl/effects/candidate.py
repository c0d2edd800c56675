"""A candidate: an effect with free parameters, where a search starts and in which steps it goes.

The functions below it help an effect's ``candidates`` to go through the elements of a model.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.effects.base import ACTUATED, Effect
from idapt_pl.effects.driven import joints_of_actuators


@dataclass(frozen=True)
class Candidate:
    """One effect with its free parameters; a vector x of them makes an :class:`Effect`.

    Attributes:
        kind: the effect's class.
        target: MJCF name.
        names: free parameters.
        nominal: their values in the nominal model, where the effect changes nothing.
        scale: what a noticeable change of each is about; fits work in units of it.
        starts: further places to start a fit from, each (parameters,).
        fixed: parameters that are not free.
        span: narrower bounds, a pair for each parameter, where more would not be this effect any more.
        strength: how many of the parameters, from the first on, say how strong it is; the others say where or how.
        plausible: what machines have, a pair for each parameter (:mod:`idapt_pl.effects.plausible`); a search keeps to
            it. None where anything may be.
        only_stands_for_none: the model has no such thing, and the nominal values are so far off that it does nothing.
    """

    kind: type[Effect]
    target: str
    names: tuple[str, ...]
    nominal: tuple[float, ...]
    scale: tuple[float, ...]
    starts: tuple[tuple[float, ...], ...] = ()
    fixed: tuple[tuple[str, object], ...] = ()
    span: tuple[tuple[float, float], ...] | None = None
    strength: int | None = None
    plausible: tuple[tuple[float, float], ...] | None = None
    only_stands_for_none: bool = False

    @property
    def label(self) -> str:
        """``effect(target)``."""
        return f"{self.kind.name}({self.target})"

    @property
    def in_model(self) -> tuple[float | None, ...]:
        """Values of the parameters in the nominal model; None of one that it does not have."""
        return (None,) * self.size if self.only_stands_for_none else self.nominal

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return len(self.names)

    def change(self, x: np.ndarray) -> float:
        """How much an effect with these values changes, in units of a noticeable change."""
        n = self.strength or self.size
        return float(np.max(np.abs(np.subtract(x, self.nominal)[:n]) / np.array(self.scale[:n])))

    def overlaps(self, other: Candidate) -> bool:
        """Whether both set the same parameters of an element: one is for it alone, and one for all of its kind."""
        shared = {"*", ACTUATED} & {self.target, other.target}
        return (self.kind, self.names) == (other.kind, other.names) and self.target != other.target and bool(shared)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the parameters: what is plausible where that is known, else what is possible."""
        if self.plausible is not None:
            return tuple(np.array(self.plausible, float).T)
        return self.possible()

    def possible(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of what a simulation can take for this effect.

        Those of a joint that never moves may have been made of next to nothing.
        """
        meta = {f.name: f.metadata for f in dataclasses.fields(self.kind)}
        low, high = (np.array([meta[n][side] for n in self.names], float) for side in ("low", "high"))
        if self.span is not None:
            narrow = np.clip(np.array(self.span, float).T, low, high)
            return narrow[0], narrow[1]
        return low, high

    def units(self) -> list[str]:
        """Units of the parameters."""
        meta = {f.name: f.metadata for f in dataclasses.fields(self.kind)}
        return [meta[n]["unit"] for n in self.names]

    def effect(self, x: Iterable[float]) -> Effect:
        """The effect with these values, moved inside the bounds."""
        low, high = self.bounds()
        values = np.clip(np.asarray(list(x), float), low, high)
        return self.kind(self.target, **dict(zip(self.names, map(float, values), strict=True)), **dict(self.fixed))

    def with_one_free(self, k: int, x: Iterable[float]) -> Candidate:
        """The same with its k-th parameter alone free, the others as in x."""
        held = tuple((name, float(v)) for i, (name, v) in enumerate(zip(self.names, x, strict=True)) if i != k)
        return dataclasses.replace(
            self,
            names=(self.names[k],),
            nominal=(self.nominal[k],),
            scale=(self.scale[k],),
            span=None if self.span is None else (self.span[k],),
            plausible=None if self.plausible is None else (self.plausible[k],),
            fixed=(*self.fixed, *held),
            starts=(),
            strength=None,
        )


@dataclass(frozen=True)
class TypicalSizes:
    """Typical sizes in the data, which set the scales of the candidates.

    Attributes:
        dt: control period, s.
        inertia: diagonal of the mass matrix, typical, (nv,).
        speed: rms of the velocities, (nv,).
        motion: spread of the positions of each scalar joint, (nv,).
        range: from their least to their greatest, (nv,).
        command: rms of the commands, (nu,).
        force: rms of the actuators' forces in the nominal model, (nu,).
        horizon: how long predictions run, s.
        effort: the largest torque or force that acted on each joint, (nv,); empty where it is not known.
        stops: where each joint was seen to come to a stop, lower and upper, rad or m, (nv, 2); NaN where it was not,
            empty where nobody looked.
        command_spread: standard deviation of the commands' magnitudes, (nu,); empty where it is not known.
        force_spread: likewise of the forces, (nu,).
    """

    dt: float
    inertia: np.ndarray
    speed: np.ndarray
    motion: np.ndarray
    range: np.ndarray
    command: np.ndarray
    force: np.ndarray
    horizon: float
    effort: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    stops: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))
    command_spread: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    force_spread: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))

    @property
    def torque(self) -> np.ndarray:
        """What would stop each joint within a prediction, N·m or N, (nv,)."""
        return self.inertia * self.speed / self.horizon


SCALED_STARTS = tuple(10.0 ** (k / 2) for k in (-3, -2, -1, 1, 2, 3))
"""Where fits of a value that cannot be below zero start too, in nominal values: as far down as up, whatever it is."""


def scaled_starts(nominal: float) -> tuple[tuple[float], ...]:
    """The places of :data:`SCALED_STARTS` for one parameter; none where the nominal value is 0."""
    return tuple((f * nominal,) for f in SCALED_STARTS) if nominal else ()


def shared(singles: list[Candidate], target: str = "*") -> list[Candidate]:
    """One value for all of a kind: none for fewer than two, or where their nominal values differ."""
    if len(singles) < 2 or len({c.nominal for c in singles}) > 1:
        return []
    scale = tuple(np.median([c.scale for c in singles], 0))
    return [dataclasses.replace(singles[0], target=target, scale=scale)]


def with_shared(singles: list[Candidate]) -> list[Candidate]:
    """The candidates whose target has a name, and one value for all of them."""
    return [c for c in singles if c.target] + shared(singles)


def scalar_joints(model: mujoco.MjModel) -> list[tuple[int, int, str]]:
    """Hinges and slides: number, degree of freedom, name."""
    return [(j, int(model.jnt_dofadr[j]), model.joint(j).name) for j in range(model.njnt) if model.jnt_type[j] >= 2]


def actuated_dofs(model: mujoco.MjModel) -> set[int]:
    """Degrees of freedom of the joints that actuators act on (of a ball or free joint, the first)."""
    return {int(model.jnt_dofadr[j]) for j in joints_of_actuators(model)}


def floating_base_dofs(model: mujoco.MjModel) -> set[int]:
    """Degrees of freedom by which a machine moves freely in the world, such as x, z and pitch of a planar walker.

    They are those of the bodies from the world on, up to the first joint with an actuator: of a body with several
    joints, or of several bodies in a row, or a slide on which a driven machine rides. Such a coordinate is no machine
    part: there is no gear, rotor, bearing or encoder. One passive hinge at the root is one, a bearing.
    """
    driven, base = actuated_dofs(model), set[int]()
    for root in np.flatnonzero(model.body_parentid == 0)[1:]:
        dofs, body = list[int](), int(root)
        while True:
            own = list(range(model.body_dofadr[body], model.body_dofadr[body] + model.body_dofnum[body]))
            if driven.intersection(own):
                break
            dofs += own
            children = np.flatnonzero(model.body_parentid == body)
            if len(children) != 1 or model.body_dofnum[body] == 0 or model.body_geomnum[body]:
                break
            body = int(children[0])
        slide = any(model.jnt_type[model.dof_jntid[v]] == mujoco.mjtJoint.mjJNT_SLIDE for v in dofs)
        if len(dofs) > 1 or (slide and drives_something(model, int(root), driven)):
            base |= set(dofs)
    return base


def drives_something(model: mujoco.MjModel, root: int, driven: set[int]) -> bool:
    """Whether an actuator acts on a joint of a body or of one that hangs on it."""
    return any(model.body_rootid[model.dof_bodyid[v]] == root for v in driven)


def joints_with_motor(model: mujoco.MjModel) -> list[tuple[int, int, str]]:
    """As :func:`mechanical_joints`, of those only that an actuator acts on: a bearing has no rotor and no magnets.

    In a model without any actuator, all: its motors may be switched off.
    """
    driven = actuated_dofs(model)
    return [joint for joint in mechanical_joints(model) if not model.nu or joint[1] in driven]


def mechanical_joints(model: mujoco.MjModel) -> list[tuple[int, int, str]]:
    """As :func:`scalar_joints`, without coordinates of a floating base."""
    base = floating_base_dofs(model)
    return [joint for joint in scalar_joints(model) if joint[1] not in base]


def shared_by_all(model: mujoco.MjModel, every: list[Candidate]) -> list[Candidate]:
    """As :func:`shared`, for all joints; none where some are a floating base, of which it would be too."""
    return [] if floating_base_dofs(model) else shared(every)


def one_per_joint(
    kind: type[Effect], parameter: str, model: mujoco.MjModel, nominal: np.ndarray, scale: np.ndarray,
    further: Iterable[float] = (), joints: Sequence[tuple[int, int, str]] | None = None,
) -> list[Candidate]:  # fmt: skip
    """A candidate for each hinge and slide that is part of a mechanism, and one value for all of them.

    Where there is a floating base, or joints differ, that one value is for the joints with actuators.

    Args:
        kind: the effect.
        parameter: the free one.
        model: the nominal one.
        nominal: where the effect changes nothing, for each degree of freedom, (nv,).
        scale: of a noticeable change, (nv,).
        further: where fits start too, in scales from nominal.
        joints: those that can have it; default :func:`mechanical_joints`.
    """
    singles, actuated = [], actuated_dofs(model)
    for _, v, name in mechanical_joints(model) if joints is None else joints:
        n, s = float(nominal[v]), float(scale[v])
        singles.append((v, Candidate(kind, name, (parameter,), (n,), (s,), tuple((n + f * s,) for f in further))))
    every = [c for _, c in singles]
    driven = shared([c for v, c in singles if v in actuated], ACTUATED)
    whole = shared_by_all(model, every) if len(every) == len(scalar_joints(model)) else []
    return every + (whole or driven)


def named_actuators(model: mujoco.MjModel) -> list[tuple[int, str]]:
    """Number and name of the actuators that have a name."""
    return [(i, name) for i in range(model.nu) if (name := model.actuator(i).name)]


def moved_bodies(model: mujoco.MjModel) -> list[tuple[int, str]]:
    """Number and name of the bodies that have a name and that some joint moves."""
    moved = [False] * model.nbody
    for b in range(1, model.nbody):  # a parent comes before its children
        moved[b] = bool(model.body_dofnum[b]) or moved[model.body_parentid[b]]
    return [(b, name) for b in range(model.nbody) if moved[b] and (name := model.body(b).name)]
