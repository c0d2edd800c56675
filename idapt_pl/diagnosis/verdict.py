"""From a finished search to a verdict, in the words of report.json."""

from __future__ import annotations

import mujoco
import numpy as np

from idapt_pl.diagnosis.data import sample_windows
from idapt_pl.diagnosis.screening import ScoreTest
from idapt_pl.diagnosis.search_state import AcceptedEffect, Search, Trial
from idapt_pl.effects.base import Effect
from idapt_pl.effects.signals import ActuatorDelay
from idapt_pl.effects.wording import unit_at
from idapt_pl.effects.world import Numerics
from idapt_pl.estimation.least_squares import effects_of, robust_loss


def build_report(search: Search, tried: list[Trial]) -> dict:
    """The report: verdict, errors on held-out episodes before and after, effects, candidates, signature."""
    sim = search.sim
    nominal, final = (search.z(search.held_out, e) for e in (search.declared, search.effects))
    before, after = (float(np.sqrt(robust_loss(z).mean())) for z in (nominal, final))
    removable_before = black_box(search, search.declared, nominal)
    removable = black_box(search, search.effects, final)
    verdict = decide(search, before, after, robust_loss(final), removable)
    physical = {
        "before": rms(sim.residual(search.declared, search.held_out.windows)),
        "after": rms(sim.residual(search.effects, search.held_out.windows)),
    }
    sensors = search.noise.sensors
    return {
        "schema": "idapt.diagnosis/1",
        "verdict": verdict,
        "error": {
            "metric": f"rms of the whitened prediction error (Huber, 4 sigma), windows of {search.steps} control steps",
            "unit": "standard deviations of the measurement noise",
            "split": "held-out episodes",
            "fit_episodes": search.fit_episodes.tolist(),
            "held_out_episodes": search.held_out_episodes.tolist(),
            "horizon_s": round(search.horizon, 6),
            "before": round(before, 4),
            "after": round(after, 4),
            "median_after": round(float(np.sqrt(np.median(robust_loss(final)))), 4),
            "noise_floor": 1.0,
            "ceiling": round(float(np.sqrt(max(1.0 - max(removable_before, 0.0), 0.0))) * before, 4),
            "removed_share": round(removed_share(before, after), 4),
            "black_box_could_still_remove": round(max(removable, 0.0), 4),
            "per_channel": {
                name: {
                    "before": float(f"{b:.4g}"),
                    "after": float(f"{a:.4g}"),
                    "noise": float(f"{n:.4g}"),
                    "unit": unit,
                }
                for name, b, a, n, unit, compared in zip(
                    sim.channels,
                    physical["before"],
                    physical["after"],
                    sensors,
                    channel_units(sim),
                    sim.compared,
                    strict=True,
                )
                if compared
            },
        },
        "effects": [describe_accepted(f, search) for f in search.found]
        + [describe_numerics(e, sim.model) for e in search.fixed if e.name == "numerics" and e not in search.declared],
        "declared": [e.to_dict() for e in search.declared],
        "candidates": [
            describe_candidate(t) for t in sorted(tried, key=lambda t: (t.round, -t.score)) if t.rejected_because
        ][:200],
        "signature": residual_signature(search, final) if verdict == "unexplained_residual" else "",
        "next_experiment": advice(search, verdict),
    }


def removed_share(before: float, after: float) -> float:
    """Share of the removable squared error that was removed; 0 where there was none."""
    return float(np.clip((before**2 - after**2) / max(before**2 - 1.0, 1e-9), -1.0, 1.0)) if before > 1.02 else 0.0


def rms(residual: np.ndarray) -> np.ndarray:
    """Root mean square of each channel, over windows and samples."""
    return np.sqrt(np.square(residual).mean((0, 1)))


def channel_units(sim) -> list[str]:
    """Units of the channels."""
    m, out = sim.model, []
    for j in range(m.njnt):
        out += {0: ["m"] * 3 + ["rad"] * 3, 1: ["rad"] * 3, 2: ["m"], 3: ["rad"]}[int(m.jnt_type[j])]
    return out + [f"{u}/s" for u in out] * sim.velocities


FLOOR, SLOPED_FLOOR = 1.6, 4.0
"""Loss up to which a model may be right; the other one where velocities are slopes of positions, which err more."""

UNPREDICTABLE = 4.0, 6.0
"""Loss of the typical window, and of one in four, from which even a remainder that nothing predicts is no noise."""


def decide(search: Search, before: float, after: float, losses: np.ndarray, removable: float) -> str:
    """The verdict; a remainder counts only if it is typical of the windows, or of a quarter, or could be predicted."""
    median_after, upper = np.quantile(losses, [0.5, 0.75])
    floor = FLOOR if search.sim.velocities else SLOPED_FLOOR
    left_over = after**2 > floor and (median_after > 1.5 or upper > UNPREDICTABLE[1] or removable > 0.25)
    if search.found:
        poor = removed_share(before, after) < 0.75 or removable > 0.3 or median_after > 2.0 or upper > UNPREDICTABLE[1]
        return "unexplained_residual" if left_over and poor else "effects_found"
    if left_over and (removable > 0.1 or median_after > UNPREDICTABLE[0] or upper > UNPREDICTABLE[1]):
        return "unexplained_residual"
    return "insufficient_excitation" if too_quiet(search) else "no_missing_effect"


def too_quiet(search: Search) -> bool:
    """Whether not even a change by half of what an actuator (or a body's mass) does would have been seen."""
    wanted = [c for c in search.candidates if c.kind.name == "actuator_gain" and c.target != "*"]
    wanted = wanted or [c for c in search.candidates if c.kind.name == "body_mass"]
    if not wanted:
        return False
    screen, limits = ScoreTest(search, search.screen, search.z), []
    for c in wanted:
        D = screen.derivative(c, np.array(c.nominal))
        limits.append(search.settings.z * c.scale[0] / max(float(np.linalg.norm(D)), 1e-12) / c.nominal[0])
    return float(np.median(limits)) > 0.5


def black_box_features(search: Search, windows) -> np.ndarray:
    """What a black box may know of a window: first state and mean commands, with squares and signs."""
    rows = []
    for e, s in zip(windows.episode, windows.start, strict=True):
        r, last = search.sim.data[e], s + windows.offsets[-1]
        actions = r.actions[s:last]
        half = len(actions) // 2
        rows.append(
            np.concatenate(
                [r.qpos[s], r.qvel[s], actions[: half or 1].mean(0), actions[half:].mean(0), r.actions[max(s - 1, 0)]]
            )
        )
    X = np.stack(rows)
    spread = X.std(0)
    X = (X - X.mean(0))[:, spread > 1e-9] / spread[spread > 1e-9]
    X = np.clip(X, -4, 4)
    return np.concatenate([X, np.square(X) - 1, np.tanh(3 * X), np.sin(2 * X)], 1)


def black_box(search: Search, effects: tuple[Effect, ...], z_held: np.ndarray) -> float:
    """Share of the held-out squared error that a ridge regression on state and commands predicts (R²)."""
    z_fit = search.z(search.fit, effects)
    both = np.concatenate([search.fit.windows.start, search.held_out.windows.start])
    windows = type(search.fit.windows)(
        np.concatenate([search.fit.windows.episode, search.held_out.windows.episode]), both, search.fit.windows.offsets
    )
    X = black_box_features(search, windows)
    A, B = X[: len(z_fit)], X[len(z_fit) :]
    target, left = np.clip(z_fit, -6, 6), np.clip(z_held, -6, 6)
    scores = []
    for strength in (1.0, 10.0, 100.0):
        ridge = np.linalg.solve(
            A.T @ A + strength * len(A) ** 0.5 * np.eye(A.shape[1]), A.T @ (target - target.mean(0))
        )
        predicted = B @ ridge + target.mean(0)
        scores.append(1.0 - np.square(left - predicted).mean() / max(np.square(left).mean(), 1e-12))
    return float(max(scores))


def describe_accepted(f: AcceptedEffect, search: Search) -> dict:
    """One accepted effect in the words of report.json."""
    without = [g for g in search.found if g is not f]
    rest = effects_of([g.candidate for g in without], [g.x for g in without])
    error, drop = (search.loss(e).mean() for e in (search.effects, (*search.fixed, *rest)))
    effect = f.candidate.effect(f.x)
    return {
        "effect": effect.name,
        "target": effect.target,
        "parameters": {
            name: {
                "nominal": float(f"{nominal:.6g}"),
                "estimate": float(f"{value:.6g}"),
                "ci95": [float(f"{v:.6g}") for v in interval],
                "unit": unit_at(search.sim.model, f.candidate.target, unit),
            }
            for name, nominal, value, interval, unit in zip(
                f.candidate.names, f.candidate.nominal, f.x, f.interval, f.candidate.units(), strict=True
            )
        },
        "fixed": dict(f.candidate.fixed),
        "error_after": round(float(np.sqrt(error)), 4),
        "error_without": round(float(np.sqrt(drop)), 4),
        "equivalent": [
            {
                "effect": t.candidate.kind.name,
                "target": t.candidate.target,
                "parameters": dict(zip(t.candidate.names, [float(f"{v:.6g}") for v in t.x[-1]], strict=True)),
                "why": f"refitted, it leaves {np.sqrt(t.held_out):.3g} on held-out episodes: no clear difference",
            }
            for t in f.equivalent
        ]
        + inseparable(f, search),
    }


def inseparable(f: AcceptedEffect, search: Search) -> list[dict]:
    """What is the same as an effect by construction, whatever the data."""
    if f.candidate.kind is not ActuatorDelay or not (f.candidate.target == "*" or search.sim.model.nu == 1):
        return []
    why = "measurements that are late and commands that are late are the same once an episode is under way"
    return [{"effect": "sensor_delay", "target": "*", "parameters": {"delay": float(f"{f.x[0]:.6g}")}, "why": why}]


def describe_numerics(effect: Numerics, model: mujoco.MjModel) -> dict:
    """Numerics as an effect of the report: discrete, so without intervals; only what differs is listed."""
    integrator = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_").lower()
    rows = [
        ("timestep", float(model.opt.timestep), effect.timestep, "s"),
        ("integrator", integrator, effect.integrator.lower(), ""),
    ]
    parameters = {
        name: {"nominal": nominal, "estimate": estimate, "ci95": None, "unit": unit}
        for name, nominal, estimate, unit in rows
        if nominal != estimate
    }
    return {"effect": "numerics", "target": "world", "parameters": parameters, "error_after": None, "equivalent": []}


def describe_candidate(t: Trial) -> dict:
    """One candidate that was not accepted."""
    gain = None if np.isnan(t.gain) else float(f"{t.gain:.4g}")
    return {
        "effect": t.candidate.kind.name,
        "target": t.candidate.target,
        "parameters": dict(zip(t.candidate.names, [float(f"{v:.6g}") for v in t.x[-1]], strict=True)) if t.x else {},
        "fixed": dict(t.candidate.fixed),
        "round": t.round + 1,
        "score": float(f"{t.score:.4g}"),
        "held_out_gain": gain,
        "rejected_because": t.rejected_because,
    }


def residual_signature(search: Search, z: np.ndarray) -> str:
    """What an unexplained residual looks like: which channel, and what it goes along with."""
    sim = search.sim
    by_channel = np.zeros(len(sim.channels))
    by_channel[sim.compared] = np.square(np.clip(z, -20, 20)).reshape(len(z), -1, sim.compared.sum()).mean((0, 1))
    worst = int(np.argmax(by_channel))
    w = search.held_out.windows
    residual = sim.residual(search.effects, w)[..., worst][:, -1]
    at = [(sim.data[e], s) for e, s in zip(w.episode, w.start, strict=True)]
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
    scored = sorted(((correlation(x, residual), name) for name, x in signals.items()), key=lambda c: -abs(c[0]))
    period = dominant_period(search, worst)
    return (
        f"largest in {sim.channels[worst]} ({np.sqrt(by_channel[worst]):.2g} sigma); goes along with "
        + ", ".join(f"{name} (r = {c:+.2f})" for c, name in scored[:3])
        + (f"; repeats every {period:.3g} s" if period else "")
        + ". A description, not a cause."
    )


def correlation(signal: np.ndarray, residual: np.ndarray) -> float:
    """Correlation, -1 to 1; with a constant, the residual's mean as a share of its rms."""
    if np.ptp(signal) < 1e-12:
        return float(residual.mean() / max(np.sqrt(np.square(residual).mean()), 1e-300) * np.sign(signal[0]))
    if np.ptp(residual) < 1e-12:
        return 0.0
    return float(np.corrcoef(signal, residual)[0, 1])


def dominant_period(search: Search, channel: int) -> float | None:
    """Period of a residual that repeats in time, from consecutive windows of the longest held-out episode."""
    sim = search.sim
    e = max(search.held_out_episodes, key=lambda i: len(sim.data[i]))
    windows = sample_windows(sim.data, np.array([e]), search.steps, 5, 10**6, 0)
    if len(windows) < 16:
        return None
    r = sim.residual(search.effects, windows)[:, -1, channel]
    power = np.square(np.abs(np.fft.rfft((r - r.mean()) * np.hanning(len(r)))))
    k = int(np.argmax(power[1:])) + 1
    return len(r) * search.horizon / k if power[k] > 0.4 * power[1:].sum() and k > 1 else None


def advice(search: Search, verdict: str) -> str:
    """What to record next."""
    confounded = [f for f in search.found if f.equivalent]
    if verdict == "insufficient_excitation":
        return (
            "Larger and more varied commands on every actuator (multisines over the range, steps, holds): "
            "these recordings barely move the joints."
        )
    if confounded:
        f = confounded[0]
        others = ", ".join(t.candidate.label for t in f.equivalent[:4])
        return f"To tell {f.candidate.label} from {others}: " + separating(search, f)
    if verdict == "unexplained_residual":
        return (
            "Repeat the same commands several times (what repeats belongs in the model, the rest is noise or time), "
            "and move one joint at a time at several speeds and loads."
        )
    return ""


def separating(search: Search, f: AcceptedEffect) -> str:
    """The recorded window on which two indistinguishable explanations disagree most: do more of that."""
    t = f.equivalent[0]
    others = tuple(g.candidate.effect(g.x) for g in search.found if g is not f)
    w = search.fit.windows
    a = search.z(search.fit, (*search.fixed, *others, f.candidate.effect(f.x)))
    b = search.z(search.fit, (*search.fixed, *others, t.candidate.effect(t.x[-1])))
    k = int(np.argmax(np.square(np.clip(a - b, -50, 50)).sum(1)))
    r, s = search.sim.data[w.episode[k]], w.start[k]
    speed = np.abs(r.qvel[s]) / (
        np.sqrt(np.mean(np.square(np.concatenate([d.qvel for d in search.sim.data])), 0)) + 1e-9
    )
    joint = search.sim.channels[int(np.argmax(speed))]
    commands = np.round(r.actions[s : s + w.offsets[-1]].mean(0), 3).tolist()
    return (
        f"record more like {r.name} at {r.time[s]:.2f} s (commands about {commands}, {joint} fast), where the two "
        f"predictions differ by {np.sqrt(np.square(a[k] - b[k]).mean()):.2g} sigma, with larger amplitudes."
    )
