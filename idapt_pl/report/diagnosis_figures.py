"""What a diagnosis looks like: measured against predicted, and the residual by channel."""

from __future__ import annotations

from collections.abc import Callable

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from idapt_pl.diagnosis.search import Diagnosis
from idapt_pl.prediction.data import Windows, sample_windows
from idapt_pl.report.diagnosis_wording import worst_channels
from idapt_pl.report.plots import AFTER, BEFORE, MEASURED, NOISE, STYLE, escape_mathtext

SHOWN_WINDOWS = 8
"""Windows shown one after the other."""

Draw = Callable[[Diagnosis], Figure]


def prediction_figure(diagnosis: Diagnosis) -> Figure:
    """Measured and predicted, before and after, in a typical stretch of held-out windows; a row a channel."""
    sim, windows = diagnosis.sim, typical_windows(diagnosis)
    channels = diagnosis.result.error.channels
    shown = worst_channels(channels)
    truth, time = measured_channels(diagnosis, windows)
    residuals = {"before": sim.residual(diagnosis.declared, windows)}
    if diagnosis.effects != diagnosis.declared:
        residuals["after"] = sim.residual(diagnosis.effects, windows)
    figure = Figure(figsize=(8.6, 0.9 + 1.8 * len(shown)), layout="constrained")
    axes = figure.subplots(len(shown), 2, sharex=True, squeeze=False)
    for (whole, error), name in zip(axes, shown, strict=True):
        channel = sim.channels.index(name)
        lines = {label: r[..., channel] for label, r in residuals.items()}
        draw_channel(whole, error, time, truth[..., channel], lines, channels[name].noise)
        whole.set_title(f"{escape_mathtext(name)} ({channels[name].unit})", loc="left", fontsize=10)
        error.set_title("measured minus predicted", loc="left", fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel(f"time in {sim.data[windows.episode[0]].name} (s)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    band, band_label = axes[0, 1].get_legend_handles_labels()
    figure.legend(handles + band[-1:], labels + band_label[-1:], loc="outside upper right", ncols=4, frameon=False)
    return figure


def draw_channel(
    whole: Axes, error: Axes, time: np.ndarray, truth: np.ndarray, residuals: dict[str, np.ndarray], noise: float
) -> None:
    """One channel: on the left what was measured and predicted, on the right the difference; a line a window."""
    whole.plot(time.ravel(), truth.ravel(), ".", color=MEASURED, ms=3.5, label="measured")
    gap = np.full((len(truth), 1), np.nan)
    for (label, residual), colour in zip(residuals.items(), (BEFORE, AFTER), strict=False):
        left = np.concatenate([np.zeros_like(gap), residual, gap], 1)  # a window starts where it was measured
        x = np.concatenate([time, gap], 1).ravel()
        name = f"predicted {label}" if len(residuals) > 1 else "predicted"
        whole.plot(x, (np.concatenate([truth, gap], 1) - left).ravel(), color=colour, lw=1.6, label=name)
        error.plot(x, left.ravel(), color=colour, lw=1.6)
    error.axhspan(-2 * noise, 2 * noise, color=NOISE, alpha=0.5, lw=0, label="± 2 σ of the noise")


def typical_windows(diagnosis: Diagnosis) -> Windows:
    """Consecutive windows of the longest held-out episode, where the error before is typical of it."""
    sim, held_out = diagnosis.sim, diagnosis.held_out
    steps = int(held_out.offsets[-1])
    episode = max(diagnosis.result.error.held_out_episodes, key=lambda e: len(sim.data[e]))
    every = sample_windows(sim.data, np.array([episode]), steps, steps, 10**6, 0)
    noise = np.array([c.noise for c in diagnosis.result.error.channels.values()])
    error = np.square(sim.residual(diagnosis.declared, every)[..., sim.compared] / noise).mean((1, 2))
    count = min(SHOWN_WINDOWS, len(every))
    level = np.convolve(error, np.ones(count) / count, "valid")
    first = int(np.argmin(np.abs(level - np.median(level))))
    return every[np.arange(first, first + count)]


def measured_channels(diagnosis: Diagnosis, windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """What was measured from the start of each window on, (n, j + 1, channels), and when, (n, j + 1).

    Rotations of balls and free bodies have no single coordinate: zero stands for what was measured.
    """
    sim, model = diagnosis.sim, diagnosis.sim.model
    samples = np.concatenate([[0], windows.offsets])
    pairs = list(zip(windows.episode, windows.start, strict=True))
    qpos, qvel, time = (
        np.stack([getattr(sim.data[e], name)[s + samples] for e, s in pairs]) for name in ("qpos", "qvel", "time")
    )
    position = np.zeros((*time.shape, model.nv))
    for j in range(model.njnt):
        q, v = model.jnt_qposadr[j], model.jnt_dofadr[j]
        size = {0: 3, 1: 0}.get(int(model.jnt_type[j]), 1)
        position[..., v : v + size] = qpos[..., q : q + size]
    return np.concatenate([position, qvel], -1) if sim.velocities else position, time


def residual_figure(diagnosis: Diagnosis) -> Figure:
    """The residual of every channel before and after, and its noise."""
    channels = diagnosis.result.error.channels
    rows = np.arange(len(channels))[::-1]
    changed = diagnosis.effects != diagnosis.declared
    bars = [("before", "before", BEFORE), ("after", "after", AFTER), ("noise", "measurement noise", NOISE)]
    if not changed:
        bars = [("before", "the model", BEFORE), bars[2]]
    figure = Figure(figsize=(7.2, 1.1 + (0.22 * len(bars) + 0.12) * len(rows)), layout="constrained")
    axis = figure.subplots()
    height = 0.82 / len(bars)
    values = np.array([[getattr(c, key) for key, *_ in bars] for c in channels.values()])
    floor = 0.5 * values[values > 0].min(initial=1.0)
    for k, (_, label, colour) in enumerate(bars):
        offset = 0.41 - height * (k + 0.5)
        axis.barh(rows + offset, np.maximum(values[:, k], floor), height, color=colour, label=label)
    axis.set_xscale("log")
    axis.set_xlim(floor, 1.5 * max(values.max(), 2 * floor))
    axis.set_yticks(rows, [f"{escape_mathtext(name)} ({c.unit})" for name, c in channels.items()])
    axis.set_ylim(-0.6, len(rows) - 0.4)
    axis.grid(False, axis="y")
    axis.set_xlabel("root mean square of measured minus predicted, in the channel's unit")
    figure.legend(loc="outside upper right", ncols=3, frameon=False)
    return figure


def diagnosis_figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """All of them, by name."""
    with matplotlib.rc_context(STYLE):
        return {name: draw(diagnosis) for name, draw in FIGURES.items()}


FIGURES: dict[str, Draw] = {"prediction": prediction_figure, "residual_by_channel": residual_figure}
