"""What to record next."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from idapt_pl.diagnosis.answer.result import Verdict
from idapt_pl.diagnosis.rounds.both_ways import NEXT_TO_NOTHING
from idapt_pl.diagnosis.rounds.revision import with_rival
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.prediction.force_windows import judges_forces

HARDLY = 0.1
"""Differences of two predictions, in standard deviations of the noise, that larger motions of the same kind do not make
much of."""


def next_experiment(context: SearchContext, state: SearchState, verdict: Verdict) -> str:
    """What to record next, in words; empty where nothing would help."""
    if verdict is Verdict.INSUFFICIENT_EXCITATION:
        return (
            "Larger and more varied commands on every actuator (multisines over the range, steps, holds): "
            "these recordings barely move the joints."
        )
    if advice := [*without_proof(context, state), *left_open(context, state)]:
        return " ".join(advice)
    if verdict is Verdict.UNEXPLAINED_RESIDUAL:
        return (
            "Repeat the same commands several times (what repeats belongs in the model, the rest is noise or time), "
            "and move one joint at a time at several speeds and loads."
        )
    return ""


def without_proof(context: SearchContext, state: SearchState) -> Iterator[str]:
    """What held-out episodes do not show."""
    if judges_forces(state.windows.fit):
        return
    if hidden := next((a for a in state.accepted if not_held_out(context, state, a)), None):
        yield (
            f"No held-out episode shows {hidden.candidate.label}: it was judged by halves of the others. To be surer, "
            f"record more like {where_it_shows(context, state, hidden)}."
        )


def left_open(context: SearchContext, state: SearchState) -> Iterator[str]:
    """What these recordings do not tell apart."""
    confounded = next((a for a in state.accepted if a.equivalent), None)
    if confounded:
        others = ", ".join(t.candidate.label for t in confounded.equivalent[:4])
        how = separating_recording(context, state, confounded)
        yield f"To tell {confounded.candidate.label} from {others}: {how}"


def not_held_out(context: SearchContext, state: SearchState, effect: AcceptedEffect) -> bool:
    """Whether held-out windows are forecast the same without an effect."""
    split = state.windows.held_out
    with_it, without = (context.loss(split, s.effects) for s in (state, state.without(effect)))
    return bool(np.abs(with_it - without).max() < NEXT_TO_NOTHING)


def where_it_shows(context: SearchContext, state: SearchState, effect: AcceptedEffect) -> str:
    """Episode and time of the fitted window that an effect changes most."""
    split = state.windows.fit
    with_it, without = (context.loss(split, s.effects) for s in (state, state.without(effect)))
    k = int(np.argmax(without - with_it))
    recording = context.sim.data[split.windows.episode[k]]
    return f"{recording.name} at {recording.time[split.windows.start[k]] - recording.time[0]:.2f} s"


def separating_recording(context: SearchContext, state: SearchState, effect: AcceptedEffect) -> str:
    """The recorded window on which two indistinguishable explanations disagree most: do more of that."""
    sim, windows = context.sim, state.windows.fit.windows
    a, b = predictions_apart(context, state, effect)
    k = int(np.argmax(np.square(np.clip(a - b, -50, 50)).sum(1)))
    r, s = sim.data[windows.episode[k]], windows.start[k]
    usual_speed = np.sqrt(np.mean(np.square(np.concatenate([d.qvel for d in sim.data])), 0)) + 1e-9
    apart = float(np.sqrt(np.square(a[k] - b[k]).mean()))
    if apart < HARDLY:
        return (
            f"no recording like these will do: nowhere do the two predictions differ by more than {apart:.2g} sigma. "
            "`idapt excite` looks for a motion that tells them apart, or says that there is none."
        )
    joint = sim.channels[int(np.argmax(np.abs(r.qvel[s]) / usual_speed))]
    commands = np.round(r.actions[s : s + windows.offsets[-1]].mean(0), 3).tolist()
    at = r.time[s] - r.time[0]
    return (
        f"record more like {r.name} at {at:.2f} s (commands about {commands}, {joint} fast), where the two "
        f"predictions differ by {apart:.2g} sigma, with larger amplitudes."
    )


def predictions_apart(
    context: SearchContext, state: SearchState, effect: AcceptedEffect
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened residuals of the fitted windows, (n, rows): with an effect, and with the first of its equivalents.

    Beside the latter the others have the values that were fitted beside it.
    """
    other = effect.equivalent[0]
    instead = with_rival(state, effect, other.candidate, other.x)
    first, second = (context.whitened(state.windows.fit, s.effects) for s in (state, instead))
    return first, second
