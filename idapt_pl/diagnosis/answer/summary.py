"""From a finished search to its result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import mujoco
import numpy as np

from idapt_pl.diagnosis.answer.advice import next_experiment
from idapt_pl.diagnosis.answer.black_box import predictable_share
from idapt_pl.diagnosis.answer.equivalents import with_equivalents_of_now
from idapt_pl.diagnosis.answer.false_discoveries import effect_probabilities
from idapt_pl.diagnosis.answer.remaining import Twin, describe_measurement, remaining_explanations
from idapt_pl.diagnosis.answer.result import (
    Alternative,
    ChannelError,
    DiagnosisResult,
    EffectEstimate,
    ErrorTable,
    ParameterEstimate,
    RejectedCandidate,
    Verdict,
)
from idapt_pl.diagnosis.answer.signature import residual_signature
from idapt_pl.diagnosis.answer.verdict import decide, removed_share
from idapt_pl.diagnosis.candidates.trial import Rejection, RejectionReason, Trial
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.effects.actuators import ActuatorKv, MotorResistance, linear_actuators
from idapt_pl.effects.joints import JointDamping
from idapt_pl.effects.signals import ActuatorDelay
from idapt_pl.effects.wording import unit_at
from idapt_pl.effects.world import Numerics
from idapt_pl.estimation.least_squares import robust_loss
from idapt_pl.prediction.force_windows import judges_forces
from idapt_pl.prediction.simulator import Simulator

MOST_CANDIDATES, FEWEST_OF_A_ROUND = 200, 40
"""Rejected candidates that a report lists: as many of each round, but so many at least."""


def summarise_search(context: SearchContext, state: SearchState, trials: Sequence[Trial]) -> DiagnosisResult:
    """Verdict, errors on held-out episodes before and after, effects, rejected candidates, signature, advice."""
    state = with_equivalents_of_now(context, state)
    nominal, final = (context.whitened(state.windows.held_out, e) for e in (context.declared, state.effects))
    before, after = (float(np.sqrt(robust_loss(z).mean())) for z in (nominal, final))
    removable = predictable_share(context, state.windows, context.declared, nominal)
    left = predictable_share(context, state.windows, state.effects, final)
    verdict = decide(context, state, before, after, robust_loss(final), left)
    tells = verdict is Verdict.UNEXPLAINED_RESIDUAL and not judges_forces(state.windows.fit)
    error = ErrorTable(
        steps=context.steps,
        horizon_s=round(context.horizon, 6),
        fit_episodes=context.fit_episodes.tolist(),
        held_out_episodes=context.held_out_episodes.tolist(),
        before=round(before, 4),
        after=round(after, 4),
        median_after=round(float(np.sqrt(np.median(robust_loss(final)))), 4),
        ceiling=round(float(np.sqrt(max(1.0 - max(removable, 0.0), 0.0))) * before, 4),
        removed_share=round(removed_share(before, after), 4),
        black_box_could_still_remove=round(max(left, 0.0), 4),
        channels=physical_errors(context, state),
        unexplained=unexplained_force_of(context, state),
    )
    explanations = remaining_explanations(
        context, state, [(a, q) for a in state.accepted for q in inseparable(context.sim.compile(state.fixed), a)]
    )
    probable = effect_probabilities(explanations)
    estimates = [
        estimate_of(context, state, a, probable[a.candidate.kind.name, a.candidate.target]) for a in state.accepted
    ]
    return DiagnosisResult(
        verdict=verdict,
        error=error,
        effects=in_order_of_trust([*estimates, *found_numerics(context, state)]),
        declared=context.declared,
        candidates=rejected_candidates(trials),
        signature=residual_signature(context, state, final) if tells else "",
        next_experiment=next_experiment(context, state, verdict),
        explanations=explanations,
        measurement=describe_measurement(context, state),
    )


def in_order_of_trust(effects: Sequence[EffectEstimate]) -> tuple[EffectEstimate, ...]:
    """What no real machine has comes last, however much it explains."""
    return tuple(sorted(effects, key=lambda e: bool(e.implausible)))


def significant(value: float, digits: int) -> float:
    """A number with so many significant digits."""
    return float(f"{value:.{digits}g}")


def physical_errors(context: SearchContext, state: SearchState) -> dict[str, ChannelError]:
    """Root mean square residuals of the held-out windows in each channel that is compared, in its unit."""
    sim, windows = context.sim, state.windows.sensitivity.held_out
    residuals = (sim.residual(effects, windows) for effects in (context.declared, state.effects))
    rms = (np.sqrt(np.square(r).mean((0, 1))) for r in residuals)
    rows = zip(sim.channels, *rms, state.windows.noise.sensors, channel_units(sim), sim.compared, strict=True)
    return {
        name: ChannelError(significant(before, 4), significant(after, 4), significant(noise, 4), unit)
        for name, before, after, noise, unit, compared in rows
        if compared
    }


def unexplained_force_of(context: SearchContext, state: SearchState) -> dict[str, float]:
    """Force that nothing explains, by channel, where models are judged by it; else empty."""
    forces = state.windows.noise.forces
    return (
        {}
        if forces is None
        else {name: significant(v, 3) for name, v in zip(context.sim.channels, forces, strict=False)}
    )


def channel_units(sim: Simulator) -> list[str]:
    """Units of the channels."""
    m, out = sim.model, []
    for j in range(m.njnt):
        out += {0: ["m"] * 3 + ["rad"] * 3, 1: ["rad"] * 3, 2: ["m"], 3: ["rad"]}[int(m.jnt_type[j])]
    return out + [f"{u}/s" for u in out] * sim.velocities


def estimate_of(
    context: SearchContext, state: SearchState, a: AcceptedEffect, probability: float | None = None
) -> EffectEstimate:
    """One accepted effect."""
    held_out, c = state.windows.held_out, a.candidate
    error, without = (context.loss(held_out, s.effects).mean() for s in (state, state.without(a)))
    twins = inseparable(context.sim.compile(state.fixed), a)
    return EffectEstimate(
        effect=c.kind.name,
        target=c.target,
        parameters=parameter_estimates(context.sim.model, a),
        fixed=dict(c.fixed),
        error_after=round(float(np.sqrt(error)), 4),
        error_without=round(float(np.sqrt(without)), 4),
        equivalent=(*map(alternative, a.equivalent), *(t.other for t in twins)),
        implausible=a.implausible,
        probability=probability,
    )


def parameter_estimates(model: mujoco.MjModel, a: AcceptedEffect) -> dict[str, ParameterEstimate]:
    """Those of an accepted effect by name, to six digits; ``model`` tells in which units."""
    assert a.interval is not None, "intervals are measured at the end of a search"
    c = a.candidate
    columns = zip(c.names, c.in_model, a.x, a.interval, c.units(), strict=True)
    return {
        name: ParameterEstimate(
            None if nominal is None else significant(nominal, 6),
            significant(value, 6),
            (significant(low, 6), significant(high, 6)),
            unit_at(model, c.target, unit),
        )
        for name, nominal, value, (low, high), unit in columns
    }


def alternative(t: Trial) -> Alternative:
    """A candidate that did as well."""
    why = f"refitted, it leaves {np.sqrt(t.held_out):.3g} on held-out episodes: no clear difference"
    return Alternative(t.candidate.kind.name, t.candidate.target, named_values(t), why)


def inseparable(model: mujoco.MjModel, a: AcceptedEffect) -> list[Twin]:
    """What is the same as an effect by construction, whatever the data."""
    c, x = a.candidate, float(a.x[0])
    if c.kind is MotorResistance:
        why = "a gain of a direct-current motor is one over its resistance"
        other = Alternative("actuator_gain", c.target, {"gain": significant(1 / x, 6)}, why)
        return [Twin(other, 1 / c.nominal[0], c.scale[0] / x**2)]
    if c.kind in (ActuatorKv, JointDamping):
        known = {(t.candidate.kind.name, t.candidate.target) for t in a.equivalent}
        return [t for t in braked_alike(model, a) if (t.other.effect, t.other.target) not in known]
    if c.kind is not ActuatorDelay or not (c.target == "*" or model.nu == 1):
        return []
    why = "measurements that are late and commands that are late are the same once an episode is under way"
    return [Twin(Alternative("sensor_delay", "*", {"delay": significant(x, 6)}, why), c.nominal[0], c.scale[0])]


def braked_alike(model: mujoco.MjModel, a: AcceptedEffect) -> list[Twin]:
    """The damping of a joint for what its servo feeds back of velocities, and the other way round.

    None where forces are limited, which cuts off the one alone, or where Euler's method integrates them differently.
    """
    implicit = model.opt.integrator in (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    c, of_damping = a.candidate, a.candidate.kind is JointDamping
    why = "what brakes a joint and what its servo feeds back of its velocity are one force"
    for i in linear_actuators(model) if implicit else ():
        j, kv, of_damping = (
            int(model.actuator_trnid[i, 0]),
            -float(model.actuator_biasprm[i, 2]),
            c.kind is JointDamping,
        )
        on_joint = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT and model.jnt_type[j] >= 2
        if not on_joint or kv <= 0 or model.actuator_forcelimited[i] or model.jnt_actfrclimited[j]:
            continue
        joint, actuator, gear = model.joint(j).name, model.actuator(i).name, float(model.actuator_gear[i, 0])
        own = float(np.ravel(model.dof_damping[model.jnt_dofadr[j]])[0])
        nominal, ratio = (kv, 1 / gear**2) if of_damping else (own, gear**2)
        value = nominal + (float(a.x[0]) - (own if of_damping else kv)) * ratio
        if c.target == (joint if of_damping else actuator) and value >= 0:
            effect, target, name = (
                ("actuator_kv", actuator, "kv") if of_damping else ("joint_damping", joint, "damping")
            )
            return [Twin(Alternative(effect, target, {name: significant(value, 6)}, why), nominal, c.scale[0] * ratio)]
    return []


def found_numerics(context: SearchContext, state: SearchState) -> list[EffectEstimate]:
    """Numerics as an effect: discrete, so without intervals; only what differs from the nominal model is listed."""
    found = [e for e in state.fixed if isinstance(e, Numerics) and e not in context.declared]
    return [EffectEstimate(Numerics.name, "world", changed_numerics(e, context.sim.model)) for e in found]


def changed_numerics(effect: Numerics, model: mujoco.MjModel) -> dict[str, ParameterEstimate]:
    """Time step and integrator where they differ from a model's."""
    integrator = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_").lower()
    rows = {
        "timestep": ParameterEstimate(float(model.opt.timestep), effect.timestep, None, "s"),
        "integrator": ParameterEstimate(integrator, effect.integrator.lower(), None, ""),
    }
    return {name: p for name, p in rows.items() if p.nominal != p.estimate}


def rejected_candidates(trials: Sequence[Trial]) -> list[RejectedCandidate]:
    """What was not accepted, by round and score: the best of each round, and whatever no machine has."""
    ranked = sorted((t for t in trials if t.rejection), key=lambda t: (t.round, -t.score))
    most = max(FEWEST_OF_A_ROUND, MOST_CANDIDATES // max(len({t.round for t in ranked}), 1))
    listed, told = Counter[int](), []
    for t in ranked:
        assert t.rejection is not None
        listed[t.round] += 1
        if listed[t.round] <= most or t.rejection.reason is RejectionReason.IMPLAUSIBLE:
            told.append(rejected_candidate(t, t.rejection))
    return told


def rejected_candidate(t: Trial, why: Rejection) -> RejectedCandidate:
    """A trial that was not accepted, as the report lists it."""
    c = t.candidate
    gain = None if np.isnan(t.gain) else significant(t.gain, 4)
    fixed, score = dict(c.fixed), significant(t.score, 4)
    strange = why.reason is RejectionReason.IMPLAUSIBLE
    return RejectedCandidate(c.kind.name, c.target, named_values(t), fixed, t.round + 1, score, gain, why.text, strange)


def named_values(t: Trial) -> dict[str, float]:
    """A trial's parameters by name."""
    return {name: significant(v, 6) for name, v in zip(t.candidate.names, t.x[-1], strict=True)}
