"""Pictures of a motion: commands, what each explanation predicts, where they part; and a clip."""

from __future__ import annotations

import io
import logging
from collections.abc import Sequence
from itertools import combinations

import imageio.v3 as iio
import matplotlib
import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from idapt_pl.effects.candidate import scalar_joints
from idapt_pl.excitation.design import SEPARATED, Goal, MotionDesign
from idapt_pl.excitation.forecast import MotionForecaster
from idapt_pl.excitation.limits import MotionLimits
from idapt_pl.excitation.plan import MotionPlan
from idapt_pl.excitation.rivals import Rival
from idapt_pl.report.plots import NOISE, STYLE, escape_mathtext

log = logging.getLogger(__name__)

RIVAL_COLOURS = ("#1f77b4", "#d1495b", "#2f7d3b", "#b07d12", "#7b4ea3", "#5a5a5a")
"""Of explanations and of pairs, over and over."""

MOST_JOINTS = 8
"""Joints and actuators that are drawn."""

CLIP_RATE, CLIP_SIZE = 12.5, 240
"""Frames per second and side of the clip, pixels."""


def motion_figure(
    design: MotionDesign, rivals: Sequence[Rival], forecaster: MotionForecaster, plan: MotionPlan
) -> Figure:
    """Commands on the left, predicted positions on the right; where that is the goal, how separations grow below."""
    model, limits, apart = forecaster.model, plan.limits, plan.goal is Goal.SEPARATE
    rows = max(min(len(scalar_joints(model)), MOST_JOINTS), min(model.nu, MOST_JOINTS))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 1.3 + 1.5 * rows + 2.2 * apart), layout="constrained")
        grid = figure.add_gridspec(rows + apart, 2, height_ratios=[1.0] * rows + [1.5] * apart)
        axes = [[figure.add_subplot(grid[row, column]) for row in range(rows)] for column in (0, 1)]
        draw_commands(axes[0], design, forecaster, limits)
        draw_positions(axes[1], design, rivals, forecaster, limits)
        if apart:
            draw_growth(figure.add_subplot(grid[-1, :]), design, rivals)
        handles, labels = axes[1][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    return figure


def draw_commands(
    axes: Sequence[Axes], design: MotionDesign, forecaster: MotionForecaster, limits: MotionLimits
) -> None:
    """A row for each actuator."""
    time = forecaster.dt * np.arange(len(design.commands) + 1)
    for i, axis in enumerate(axes):
        if i >= forecaster.model.nu:
            axis.set_visible(False)
            continue
        axis.step(time, np.append(design.commands[:, i], design.commands[-1, i]), where="post", color="#222222", lw=1.2)
        for end in limits.command[i]:
            axis.axhline(end, color=NOISE, ls="--", lw=1)
        axis.set_title(f"command of {escape_mathtext(forecaster.model.actuator(i).name)}", loc="left", fontsize=10)
        axis.set_xlabel("time (s)" if i == len(axes) - 1 else "")


def draw_positions(
    axes: Sequence[Axes],
    design: MotionDesign,
    rivals: Sequence[Rival],
    forecaster: MotionForecaster,
    limits: MotionLimits,
) -> None:
    """A row for each joint, a line for each explanation."""
    joints = scalar_joints(forecaster.model)[: len(axes)]
    for i, axis in enumerate(axes):
        if i >= len(joints):
            axis.set_visible(False)
            continue
        j, v, name = joints[i]
        for k, (seen, rival) in enumerate(zip(design.forecasts, rivals, strict=True)):
            q = seen.qpos[0, :, forecaster.model.jnt_qposadr[j]]
            width, dashes = (2.4, "-") if k == 0 else (1.2, "--")
            label, colour = escape_mathtext(rival.name), RIVAL_COLOURS[k % len(RIVAL_COLOURS)]
            axis.plot(seen.time, q, label=label, color=colour, lw=width, ls=dashes)
        low, high = axis.get_ylim()
        for end in limits.position[v]:
            if 2 * low - high <= end <= 2 * high - low:
                axis.axhline(end, color=NOISE, ls="--", lw=1)
        unit = "m" if forecaster.model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE else "rad"
        axis.set_title(f"predicted {escape_mathtext(name)} ({unit})", loc="left", fontsize=10)
        axis.set_xlabel("time (s)" if i == len(axes) - 1 else "")


def draw_growth(axis: Axes, design: MotionDesign, rivals: Sequence[Rival]) -> None:
    """How far each pair is apart after so much of the motion."""
    ends, apart = design.growth
    for k, ((a, b), line) in enumerate(zip(combinations(rivals, 2), apart, strict=True)):
        label = escape_mathtext(f"{a.name} / {b.name}")
        axis.plot(ends, line, color=RIVAL_COLOURS[k % len(RIVAL_COLOURS)], lw=1.6, label=label)
    axis.axhline(SEPARATED, color=NOISE, ls="--", lw=1)
    axis.set_title("separation so far, in standard deviations (dashed: told apart)", loc="left", fontsize=10)
    axis.set_xlabel("time (s)")
    axis.legend(frameon=False, fontsize=8)


def motion_clip(design: MotionDesign, forecaster: MotionForecaster) -> bytes | None:
    """A GIF of the motion under the leading explanation, by the first camera; None without a camera, or without GL."""
    model = forecaster.sim.spec.copy().compile()  # that of the simulator has no textures
    if not model.ncam:
        return None
    seen, data = design.forecasts[0], mujoco.MjData(model)
    step = max(1, round(1 / (CLIP_RATE * forecaster.dt)))
    try:
        with mujoco.Renderer(model, CLIP_SIZE, CLIP_SIZE) as renderer:
            frames = [frame_of(renderer, model, data, q) for q in seen.qpos[0, ::step]]
    except Exception as error:  # without GL it can be anything, and the motion does not need its picture
        log.warning("no clip of the motion, as it could not be drawn: %s", error or type(error).__name__)
        return None
    buffer = io.BytesIO()
    iio.imwrite(buffer, np.stack(frames), extension=".gif", duration=1000 * step * forecaster.dt, loop=0)
    return buffer.getvalue()


def frame_of(renderer: mujoco.Renderer, model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> np.ndarray:
    """One pose as the first camera sees it."""
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    renderer.update_scene(data, camera=0)
    return renderer.render()
