"""What a finished run left: the grounding its config describes, its policies, its G."""

from __future__ import annotations

import json
from pathlib import Path

from cli.fit import GroundingCLI, build
from idapt_pl.effects import effect_from_dict
from idapt_pl.grounding import IterativeGrounding
from idapt_pl.modules import AsymmetricSAC, VisualTransformation
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.stage import load_finished


def open_run(run: Path) -> IterativeGrounding:
    """The grounding of a run folder, its source with the effects that the run discovered.

    Raises:
        ValueError: if it is no run folder.
    """
    config = run / "config.yaml"
    if not config.is_file():
        raise ValueError(f"{run} is not a run folder: it has no config.yaml. Give the folder that `idapt fit` wrote.")
    grounding = build(GroundingCLI(["--config", str(config), "--run_dir", str(run)]))[0]
    for path in [*run.glob("step_00/looks.json"), *sorted(run.glob("step_*/effects.json"))]:
        grounding.worlds.repair(effect_from_dict(e) for e in json.loads(path.read_text())["effects"])
    return grounding


def load_policy(grounding: IterativeGrounding, path: Path) -> AsymmetricSAC:
    """A policy from its checkpoint (weights only, nothing is unpickled)."""
    worlds = grounding.worlds
    return load_finished(grounding.fit.make.policy(**worlds.dimensions, **worlds.action_bounds), path)


def load_visual(grounding: IterativeGrounding) -> VisualTransformation:
    """G and P^T of the last grounding step that has them.

    Raises:
        ValueError: if there is none yet.
    """
    run = grounding.stages.run_dir
    made = sorted(run.glob("step_*/visual/final.ckpt"))
    if not made:
        raise ValueError(f"{run} has no finished visual stage yet; resume it: idapt fit --config {run / 'config.yaml'}")
    return load_finished(grounding.fit.make.visual(**grounding.worlds.dimensions), made[-1])


def load_estimator(grounding: IterativeGrounding) -> PixelStatePredictor:
    """What estimates states from target images: the newest policy's encoder, where that is an estimator, else P^T."""
    G, made = load_visual(grounding), sorted(grounding.stages.run_dir.glob("step_*/policy/final.ckpt"))
    return load_policy(grounding, made[-1]).estimator(G) if made else G.P_T
