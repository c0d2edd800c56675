"""``idapt check``: what source and target of a config show, and whether they move alike, before hours of training."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import imageio.v3 as iio
import numpy as np

from cli.arguments import parser
from cli.fit import GroundingCLI
from idapt_pl.envs import ActionMap
from idapt_pl.files import write_atomically
from idapt_pl.ranges import Range, check_ranges
from idapt_pl.run import Run
from idapt_pl.run_folder.shipped_configs import config_path
from idapt_pl.targets import RecordedTarget, RobotTarget
from idapt_pl.targets.action_units import action_units
from idapt_pl.targets.recording_check import recorded_suspicions
from idapt_pl.targets.trial_moves import TrialMoves, suspicions, told_pace, try_moves

SAME_BOUND, LITTLE_USED = 1e-3, 0.1
"""Shares of a range: by which a bound may be passed, and below which hardly any of it is used."""

LARGE = 4
"""How many times as large as in the run pictures are."""


def main(args: list[str]) -> int:
    """Run ``idapt check``. Returns 1 if something looks wrong."""
    p = parser("check", __doc__)
    p.add_argument(
        "--config", type=config_path, action="append", required=True, help="as of `idapt fit`; may be repeated"
    )
    p.add_argument("--out", type=Path, default=Path("check.png"), help="picture to write")
    p.add_argument("--share", type=float, default=0.3, help="how far actuators are pushed, of their ranges")
    p.add_argument(
        "--move-target",
        action="store_true",
        help="push the target's actuators too: a robot moves. Else only its first image is looked at",
    )
    o = p.parse_args(args)
    check_ranges("", {"--share": o.share}, {"--share": Range(0, 1, "(]")})
    run = GroundingCLI([f"--config={path}" for path in o.config]).run()
    worlds = run.worlds
    with closing(worlds.source(1)) as env:
        source = try_moves(env, o.share)
    target, shown, bounds = look_at_target(run, o.share if o.move_target else None)
    print(actions_table(run, bounds))
    picture = sheet(source, target, shown)
    write_atomically(o.out, lambda temporary: temporary.write_bytes(iio.imwrite("<bytes>", picture, extension=".png")))
    names = worlds.actions.names or tuple(map(str, range(len(source.motion))))
    source_names = tuple(names[int(np.flatnonzero(worlds.actions.order == i)[0])] for i in range(len(names)))
    found = suspicions(source, target, source_names, shown, worlds.frame_stack)
    if isinstance(worlds.target, RecordedTarget):
        found += recorded_suspicions(worlds.target, worlds.look)
    if told := worlds.views_apart:
        found.append(told)
    if target is not None:
        print(f"\nthe target took {target.steps} control steps for this; they are in no run's ledger")
        if target.took and isinstance(worlds.target, RobotTarget) and not worlds.target.simulated:
            print(told_pace(target.took, worlds.period))
    for sentence in [*(beyond_bounds(worlds.actions, *bounds) if bounds else ()), *found]:
        print(f"- {sentence}")
    print(f"\n{'look at' if not found else 'something looks wrong; look at'} {o.out}: {sheet_legend(target)}")
    return int(bool(found))


Bounds = tuple[np.ndarray, np.ndarray]
"""Lower and upper bounds of actions, (nu,) each."""


def look_at_target(run: Run, share: float | None) -> tuple[TrialMoves | None, np.ndarray | None, Bounds | None]:
    """The target when its actuators are pushed, if they may be; its first image, if there is one; its own bounds."""
    target = run.worlds.target
    if isinstance(target, RecordedTarget):
        return None, first_frame(run, target), None
    with closing(run.worlds.blind_target(-1)) as env:
        if share is not None:
            moves = try_moves(env, share)
            return moves, moves.start, env.own_bounds
        return None, env.reset(seed=0)[0]["pixels"][0, -1], env.own_bounds


def first_frame(run: Run, target: RecordedTarget) -> np.ndarray | None:
    """Of what was recorded for step 0; None where nothing is there yet."""
    if target.inbox is not None and not target.brought(0):
        return None
    return target.recording(0, run.worlds.look).episodes[0].observations["pixels"][0]


def actions_table(run: Run, bounds: Bounds | None = None) -> str:
    """The actions of source and target, in words: what the target is told, and what it takes if that is known."""
    actions, period = run.worlds.actions, run.worlds.period
    low, high = actions.ends
    lines = [
        f"control period {period:g} s; images {run.config.image_size} pixels, {run.config.frame_stack} at a time",
        "",
    ]
    units = action_units(run.worlds.source_domain.compile())
    takes = f"{'target takes':>24}" if bounds else ""
    lines.append(f"{'action':<20}{'source':>32}{'target is told':>24}{takes}")
    for i, j in enumerate(actions.order):
        name = actions.names[i] if actions.names else str(j)
        pairs = [
            (actions.low[j], actions.high[j]),
            (low[i], high[i]),
            *([(bounds[0][i], bounds[1][i])] if bounds else []),
        ]
        told, *others = (f"{a:.4g} to {b:.4g}" for a, b in pairs)
        lines.append(f"{name:<20}{f'{told} {units[j]}'.strip():>32}" + "".join(f"{other:>24}" for other in others))
    return "\n".join(lines)


def beyond_bounds(actions: ActionMap, low: np.ndarray, high: np.ndarray) -> list[str]:
    """Actions that the target is told beyond its own bounds, or that use little of them, a sentence each."""
    found = []
    for i, (a, b) in enumerate(zip(*actions.ends, strict=True)):
        name, width = actions.names[i] if actions.names else f"action {i}", high[i] - low[i]
        told, takes = f"{name} is told {a:.4g} to {b:.4g}", f"the target takes {low[i]:.4g} to {high[i]:.4g}"
        if a < low[i] - SAME_BOUND * width or b > high[i] + SAME_BOUND * width:
            found.append(f"{told}, and {takes}: what is beyond is clipped (see target.actions)")
        elif b - a < LITTLE_USED * width:
            found.append(f"{told}, and {takes}: are these the same units (see target.actions)?")
    return found


def sheet(source: TrialMoves, target: TrialMoves | None, shown: np.ndarray | None) -> np.ndarray:
    """Source above, target below: the start, and each actuator pushed one way and the other; white where none is."""
    above = in_a_row(source)
    below = np.full_like(above, 255) if target is None else in_a_row(target)
    if shown is not None:
        below[:, : shown.shape[1]] = shown
    return np.concatenate([above, below]).repeat(LARGE, 0).repeat(LARGE, 1)


def in_a_row(world: TrialMoves) -> np.ndarray:
    """The start, and each actuator pushed one way and the other, beside each other."""
    pairs = zip(world.plus, world.minus, strict=True)
    return np.concatenate([world.start, *(frame for pair in pairs for frame in pair)], 1)


def sheet_legend(target: TrialMoves | None) -> str:
    """What the picture shows."""
    moved = "the same in the target" if target is not None else "the target's first image (--move-target pushes it too)"
    return f"above the source, from left to right its start and each action pushed up and down; below {moved}"
