"""In which steps after an episode's start do images tell what the source lacks? Misfits of effects, window by window.

    python benchmarks/forecast_windows.py --runs runs/half_cheetah_hard_0 --windows 0-6 0-10 6-12 \
        --effects "joint_armature actuated armature 0.3" "joint_armature actuated armature 0.4"

The recordings of step 0 are forecast from known starts as in the search of a run, with the plain source and with each
effect. A row says how much worse (nats, of one component and step) forecasts with the effect are than without in a
window of control steps; what is missing has a low one. Where G learned the first steps as pairs
(``schedule.paired_steps``) these say what the source would do. Writes results/forecast_windows.csv.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

import numpy as np
import torch

from benchmarks.tables import replace_rows
from cli.provenance import git_commit
from idapt_pl.effects import Effect, effect_from_dict
from idapt_pl.run import Run
from idapt_pl.stages.encoder import fit_encoder
from idapt_pl.stages.known_start_search import MEMBERS_JUDGED, RECORDINGS_CHOSEN_BY
from idapt_pl.stages.refinement import KnownStartForecasts, known_start_forecasts, misfits

KEY = ("run", "window", "effect")


def forecasts_of(run: Run) -> KnownStartForecasts:
    """Of step 0's recordings, by the source as it was and the encoder of the time."""
    c, step = run.context, run.step_folder(0)
    c.worlds.source_domain = c.worlds.task.domain("source")
    G = run.load_visual(step / "visual/final.ckpt")
    source_policy = run.load_policy(step / "source_policy/final.ckpt")
    pi = fit_encoder(c, 0, (step / "source.h5",), run.config.schedule.pretrain.estimator, G, source_policy)
    paired, sizes = run.config.schedule.paired_steps, (RECORDINGS_CHOSEN_BY, MEMBERS_JUDGED)
    return known_start_forecasts(c, [step / "target.h5"], step / "control.h5", G, pi, 7, *sizes, paired)[0]


def surprises(forecasts: KnownStartForecasts, effects: Sequence[Effect], steps: int) -> list[np.ndarray]:
    """How far every recording is from what was forecast after each step, (T, c), in spreads."""
    domain = forecasts.smooth.domain.with_effects(*effects)
    followed = [r.first(steps) for r in forecasts.recordings]
    made = replace(forecasts.smooth, domain=domain)(followed, forecasts.seed)
    return [s.surprise[1:, forecasts.shown] / forecasts.scale for s in made]


def effect_of(told: str) -> Effect:
    """From "NAME TARGET PARAMETER VALUE"."""
    name, target, parameter, value = told.split()
    return effect_from_dict({"effect": name, "target": target, "parameters": {parameter: float(value)}})


def main() -> None:
    """Measure every run."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--runs", type=Path, nargs="+", required=True, help="folders of runs with effects.refine")
    p.add_argument("--windows", nargs="+", required=True, metavar="A-B", help="control steps A to B after the start")
    p.add_argument("--effects", nargs="+", required=True, metavar="'NAME TARGET PARAMETER VALUE'")
    p.add_argument("--out", type=Path, default=ROOT / "results/forecast_windows.csv")
    o = p.parse_args()
    torch.set_num_threads(1)
    windows = [(int(a), int(b)) for a, b in (w.split("-") for w in o.windows)]
    for folder in o.runs:
        forecasts = forecasts_of(Run.open(folder))
        longest = max(b for _, b in windows)
        without = surprises(forecasts, [], longest)
        for told in o.effects:
            seen = surprises(forecasts, [effect_of(told)], longest)
            for a, b in windows:
                score = [misfits([s[a:b] for s in x if len(s) > a + 2]).mean() for x in (seen, without)]
                row = {"run": folder.name, "window": f"{a}-{b}", "effect": told}
                row |= {"worse_by": round(float(score[0] - score[1]), 3), "commit": git_commit()}
                replace_rows(o.out, [row], KEY)
                print(*row.values(), flush=True)


if __name__ == "__main__":
    main()
