"""What an unexplained residual looks like: which channel, what it goes along with, and whether it repeats."""

from __future__ import annotations

import numpy as np

from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.prediction.data import Windows, sample_windows
from idapt_pl.prediction.simulator import Simulator


def residual_signature(context: SearchContext, state: SearchState, z: np.ndarray) -> str:
    """The channel with the largest residual and what goes along with it; ``z``: whitened, held out, (n, rows)."""
    sim, windows = context.sim, state.windows.held_out.windows
    by_channel = np.zeros(len(sim.channels))
    by_channel[sim.compared] = np.square(np.clip(z, -20, 20)).reshape(len(z), -1, sim.compared.sum()).mean((0, 1))
    worst = int(np.argmax(by_channel))
    residual = sim.residual(state.effects, windows)[..., worst][:, -1]
    signals = possible_causes(sim, windows)
    scored = sorted(((correlation(x, residual), name) for name, x in signals.items()), key=lambda c: -abs(c[0]))
    period = dominant_period(context, state, worst)
    return (
        f"largest in {sim.channels[worst]} ({np.sqrt(by_channel[worst]):.2g} sigma); goes along with "
        + ", ".join(f"{name} (r = {c:+.2f})" for c, name in scored[:3])
        + (f"; repeats every {period:.3g} s" if period else "")
        + ". A description, not a cause."
    )


def possible_causes(sim: Simulator, windows: Windows) -> dict[str, np.ndarray]:
    """Signals at the start of every window, (n,) each: time, velocities, positions, commands and functions of them."""
    at = [(sim.data[e], s) for e, s in zip(windows.episode, windows.start, strict=True)]
    nv, names = sim.model.nv, sim.channels[: sim.model.nv]
    signals = {"1": np.ones(len(at)), "time in the episode": np.array([r.time[s] - r.time[0] for r, s in at])}
    for i in range(nv):
        v = np.array([r.qvel[s, i] for r, s in at])
        signals |= {f"v({names[i]})": v, f"v|v|({names[i]})": v * np.abs(v), f"sign v({names[i]})": np.sign(v)}
        if sim.model.nq == nv:
            q = np.array([r.qpos[s, i] for r, s in at])
            signals |= {f"q({names[i]})": q, f"sin 6q({names[i]})": np.sin(6 * q), f"cos 6q({names[i]})": np.cos(6 * q)}
    for i in range(sim.model.nu):
        u = np.array([r.actions[s, i] for r, s in at])
        signals |= {f"u({i})": u, f"u|u|({i})": u * np.abs(u), f"sign u({i})": np.sign(u)}
    return signals


def correlation(signal: np.ndarray, residual: np.ndarray) -> float:
    """Correlation, -1 to 1; with a constant, the residual's mean as a share of its rms."""
    if np.ptp(signal) < 1e-12:
        return float(residual.mean() / max(np.sqrt(np.square(residual).mean()), 1e-300) * np.sign(signal[0]))
    if np.ptp(residual) < 1e-12:
        return 0.0
    return float(np.corrcoef(signal, residual)[0, 1])


def dominant_period(context: SearchContext, state: SearchState, channel: int) -> float | None:
    """Period in seconds of a residual that repeats in time, from consecutive windows of the longest held-out episode.

    None where no frequency has 40 % of the power.
    """
    sim = context.sim
    e = max(context.held_out_episodes, key=lambda i: len(sim.data[i]))
    windows = sample_windows(sim.data, np.array([e]), context.steps, 5, 10**6, 0)
    if len(windows) < 16:
        return None
    r = sim.residual(state.effects, windows)[:, -1, channel]
    power = np.square(np.abs(np.fft.rfft((r - r.mean()) * np.hanning(len(r)))))
    k = int(np.argmax(power[1:])) + 1
    return len(r) * context.horizon / k if power[k] > 0.4 * power[1:].sum() and k > 1 else None
