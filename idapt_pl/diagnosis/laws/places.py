"""Where an unexplained residual lives: at which joint, as a force or as an error of its sensor, and what it follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from idapt_pl.diagnosis.laws.forecasts import JointForecasts, regress
from idapt_pl.diagnosis.laws.terms import Term, of_position
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.effects.candidate import mechanical_joints
from idapt_pl.effects.expression import parse_expression
from idapt_pl.prediction.whitening import whiten

CLEARER = 1.2
"""By what factor an error of a sensor must explain more than any force, to be held responsible."""

MOST_OF_IT = 0.4
"""Share of what is left that it must explain."""


@dataclass(frozen=True)
class ResidualPlace:
    """What one force or one sensor explains of a residual, by regression.

    Attributes:
        joint: its name.
        kind: ``"force"`` or ``"sensor"``.
        share: of the squared residual that the best single term removes, 0 to 1.
        follows: signals of that term.
        term: its formula.
    """

    joint: str
    kind: str
    share: float
    follows: tuple[str, ...]
    term: str

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        share = round(self.share, 4)
        return {
            "joint": self.joint,
            "kind": self.kind,
            "share": share,
            "follows": list(self.follows),
            "term": self.term,
        }


def residual_places(
    context: SearchContext, state: SearchState, forecasts: Sequence[JointForecasts]
) -> list[ResidualPlace]:
    """Forces and sensors of all joints, those that explain most first."""
    places = [p for f in forecasts if (p := of_force(f))]
    joints = {name: (j, v) for j, v, name in mechanical_joints(context.sim.model)}
    places += [p for f in forecasts if (p := of_sensor(context, state, f, *joints[f.sizes.name]))]
    return sorted(places, key=lambda p: -p.share)


def of_force(f: JointForecasts) -> ResidualPlace | None:
    """The best single term of a force on a joint."""
    if not f.single_terms:
        return None
    best = max(f.single_terms, key=lambda at: regress(at.columns, f.test.left)[1])
    share = regress(best.columns, f.test.left)[1] / max(f.test.total, 1e-12)
    return place(f, "force", best.terms[0], share)


def of_sensor(
    context: SearchContext, state: SearchState, f: JointForecasts, joint: int, dof: int
) -> ResidualPlace | None:
    """The best single term of what an encoder may add to the angle that it shows.

    It shifts what is compared, and the state that a forecast begins with, which is measured too.
    """
    sim, split = context.sim, state.windows.fit
    slope, windows, nv = state.windows.sensitivity.at_fit.slope, split.windows, sim.model.nv
    at = windows.start[:, None] + np.concatenate([[0], windows.offsets])
    address = int(sim.model.jnt_qposadr[joint])
    q = np.stack([sim.data[e].qpos[k, address] for e, k in zip(windows.episode, at, strict=True)])
    v = np.stack([sim.data[e].qvel[k, dof] for e, k in zip(windows.episode, at, strict=True)])
    best: tuple[float, Term] | None = None
    for term in of_position(f.sizes):
        columns = []
        for text in term.columns():
            expression = parse_expression(text)
            shown = lambda x, e=expression: np.broadcast_to(e.value({"q": x}, np.zeros((*x.shape, 0))), x.shape)  # noqa: E731
            step = 1e-4 * f.sizes.spread
            error, rate = shown(q), v * (shown(q + step) - shown(q - step)) / (2 * step)
            moved = slope[..., dof] * error[:, :1, None] + slope[..., nv + dof] * rate[:, :1, None]
            moved[:, :, dof] += error[:, 1:]
            if sim.velocities:
                moved[:, :, nv + dof] += rate[:, 1:]
            columns.append(whiten(split.W, moved).ravel())
        gain = regress(f.test.clear(np.stack(columns, 1)), f.test.left)[1]
        if best is None or gain > best[0]:
            best = gain, term
    return place(f, "sensor", best[1], best[0] / max(f.test.total, 1e-12)) if best else None


def place(f: JointForecasts, kind: str, term: Term, share: float) -> ResidualPlace:
    """A place in words."""
    follows = frozenset().union(*(parse_expression(text).signals for text in term.columns()))
    return ResidualPlace(f.sizes.name, kind, float(share), tuple(sorted(follows)), " + ".join(term.columns()))


def blamed_sensor(places: Sequence[ResidualPlace]) -> ResidualPlace | None:
    """The sensor whose error explains much, and clearly more than any force does."""
    best = {
        kind: max((p for p in places if p.kind == kind), key=lambda p: p.share, default=None)
        for kind in ("force", "sensor")
    }
    sensor, force = best["sensor"], best["force"]
    if sensor is None or sensor.share < MOST_OF_IT or "q" not in sensor.follows:
        return None
    return sensor if force is None or sensor.share > CLEARER * force.share else None
