"""The stage of π's encoder, where it is an estimator of states: regressed on source images as G shows them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from datamodules import Trajectories
from datamodules.unpaired import read_all
from idapt_pl.modules import AsymmetricSAC, VisualTransformation
from idapt_pl.nets.units import Units, take_in_units
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.state_predictor import fit_P_S


def fit_encoder(
    c: StageContext, step: int, source: Sequence[Path], batches: int, G: VisualTransformation, pi: AsymmetricSAC,
    poses: Sequence[Path] = (), prefix: str = "",
) -> AsymmetricSAC:  # fmt: skip
    """π with its encoder regressed on all labelled source images, as G shows them; 0 batches leave π as it is.

    While π trains it meets few states, near those it holds. F and the next policies need estimates that are right
    wherever G has data.

    Args:
        c: of the run.
        step: grounding step.
        source: trajectory files with images and states.
        batches: of the encoder.
        G: shows source images as target images.
        pi: whose encoder goes on.
        poses: trajectory files with target-like images and states that no motion brings about.
        prefix: of the stages' names.
    """
    if not batches:
        return pi
    files = [translated(c, step, source, G, f"{prefix}translated"), *poses]
    return fit_encoder_on(c, step, f"{prefix}estimator", files, batches, pi)


def poses_through(
    c: StageContext, step: int, moved: Sequence[Path], G: VisualTransformation, prefix: str = ""
) -> list[Path]:
    """``moved_translated.h5``: images of moved poses as G shows them; none if there are none."""
    return [translated(c, step, moved, G, f"{prefix}moved_translated")] if moved else []


def translated(
    c: StageContext, step: int, source: Sequence[Path], G: VisualTransformation, name: str = "translated"
) -> Path:
    """``<name>.h5``: labelled source images as G shows them."""

    def make(seed: int) -> Trajectories:
        seen = read_all(source, also="state")
        episodes = tuple(G.translate_episode(episode) for episode in seen)
        return replace(seen, episodes=episodes, source=f"{seen.source}, as G shows it")

    return c.stages.record(step, name, make)[0]


def fit_encoder_on(
    c: StageContext, step: int, name: str, labelled: Sequence[Path], batches: int, pi: AsymmetricSAC
) -> AsymmetricSAC:
    """π with its encoder regressed on the states of labelled, target-like images, in any light.

    What reads the encoder (a filter, the head) makes the same of readings in the encoder's new units.
    """
    pi = copy.deepcopy(pi)
    before, head = Units.of(pi.actor.encoder), pi.actor.head[0]
    estimator = c.make.state_predictor(**c.worlds.dimensions, relight=pi.hparams.relight)
    estimator.P_S.load_state_dict(pi.actor.encoder.state_dict())
    estimator = fit_P_S(c, step, labelled, batches, estimator, name)
    pi.actor.encoder.load_state_dict(estimator.P_S.state_dict())
    now = Units.of(pi.actor.encoder)
    take_in_units(head.weight, head.bias, before, now)
    if pi.filter is not None:
        pi.filter.tell_in_units(before, now)
    return pi
