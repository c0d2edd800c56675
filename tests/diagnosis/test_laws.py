"""Laws of force where the library has no effect: found with joint and dependence, and not where nothing is."""

import functools

import mujoco
import numpy as np
import pytest

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.answer.law_result import formula_in_numbers, largest_and_usual_force
from idapt_pl.diagnosis.answer.summary import parameter_estimates
from idapt_pl.diagnosis.laws import search as law_search
from idapt_pl.diagnosis.laws.candidate import law_candidate
from idapt_pl.diagnosis.laws.forecasts import regress
from idapt_pl.diagnosis.laws.network import HIDDEN, network
from idapt_pl.diagnosis.laws.search import laws_of, search_laws
from idapt_pl.diagnosis.laws.terms import JointSizes, Term, dictionary, term_units, write_law
from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.state.search_state import AcceptedEffect
from idapt_pl.effects.acting import ActingForces
from idapt_pl.effects.expression import parse_expression
from idapt_pl.effects.learned import LearnedForce, ResidualNetwork
from idapt_pl.prediction.data import sample_windows
from idapt_pl.prediction.law_history import remembered

PENDULUM = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody><body name="rod"><joint name="axis" axis="0 1 0" damping="0.05" armature="0.01"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.4" mass="0.5" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><motor name="axis" joint="axis" gear="2"/></actuator>
</mujoco>"""
SIZES = JointSizes("axis", True, np.linspace(-1, 1, 7), 2.0, 1.0, 2.0, 0.02, "u")


def nothing(q, v, u, t):
    return 0.0


def ripple(q, v, u, t):
    return 0.6 * u * np.sin(5 * q)


def viscous(q, v, u, t):
    return -0.1 * v


def detent(q, v, u, t):
    return 0.4 * np.sin(6 * q)


def record(law, episodes=5, steps=90, xml=PENDULUM):
    """Recordings of the pendulum with a force on its axis, of its own making."""
    model, rng, made = mujoco.MjModel.from_xml_string(xml), np.random.default_rng(0), []
    for _ in range(episodes):
        data = mujoco.MjData(model)
        data.qpos[0] = rng.normal() * 0.5
        actions = np.repeat(rng.uniform(-1, 1, (steps // 3, model.nu)), 3, 0)
        rows = [(data.qpos[0], data.qvel[0])]
        for action in actions:
            data.ctrl[:] = action
            for _ in range(4):
                data.qfrc_applied[0] = law(data.qpos[0], data.qvel[0], action.sum(), data.time)
                mujoco.mj_step(model, data)
            rows.append((data.qpos[0], data.qvel[0]))
        seen = np.array(rows) + rng.normal(size=(steps + 1, 2)) * (5e-4, 1e-2)
        made.append(Episode(actions.astype(np.float32), {"qpos": seen[:, :1], "qvel": seen[:, 1:]}))
    return Trajectories(tuple(made), 0.02)


@functools.cache
def begun(law):
    return begin_search(mujoco.MjSpec.from_string(PENDULUM), record(law), threads=1)


def test_a_force_that_no_effect_has_is_found_with_its_joint_dependence_and_size(caplog):
    caplog.set_level("INFO", "idapt_pl.diagnosis.laws.search")
    context, state = begun(ripple)
    found = search_laws(context, state)
    (law,) = laws_of(found.state)
    assert law.candidate.target == "axis" and law.candidate.depends == {"q", "u"}
    assert caplog.messages[0].startswith("looking for a law of force"), "it may take long, and is told first"
    left = context.loss(found.state.windows.held_out, found.state.effects).mean()
    before = context.loss(found.before.windows.held_out, found.before.effects).mean()
    assert before > 5 and left < 1.5
    force = law.candidate.effect(law.x)
    q, u = np.linspace(-1, 1, 9), np.full(9, 0.7)
    np.testing.assert_allclose(force.force_from({"q": q, "u": u}, np.zeros((9, 0))), ripple(q, 0, u, 0), atol=0.06)
    assert found.places[0].kind == "force" and set(found.places[0].follows) == {"q", "u"}
    largest, usual = largest_and_usual_force(context, found.state, law)
    assert largest == pytest.approx(0.55, abs=0.06) and usual == pytest.approx(2 / np.sqrt(3), rel=0.1), "gear 2"


def test_a_machine_without_motors_has_laws_too():
    passive = PENDULUM[: PENDULUM.index("<actuator>")] + "</mujoco>"
    found = search_laws(*begin_search(mujoco.MjSpec.from_string(passive), record(detent, xml=passive), threads=1))
    (law,) = laws_of(found.state)
    assert law.candidate.target == "axis" and law.candidate.depends == {"q"}


def test_nothing_is_learned_where_nothing_is_planted(monkeypatch):
    context, state = begun(nothing)
    assert search_laws(context, state) is None, "too little is left to look for"
    monkeypatch.setattr(law_search, "LEFT_OVER", 0.0)
    found = search_laws(context, state)
    assert not laws_of(found.state) and found.network is None and not found.sensor, "nor if it has to look"


def test_a_push_moves_forecasts_as_the_same_force_by_a_law_does():
    context, _ = begun(nothing)
    windows = sample_windows(context.sim.data, np.arange(3), context.steps, 5, 20, 0)
    push = np.full((len(windows), context.steps, 1), 0.3)
    by_push = context.sim.residual((), windows, push=push)
    by_law = context.sim.residual((LearnedForce("axis", "a", a=0.3),), windows)
    np.testing.assert_allclose(by_push, by_law, atol=1e-9)
    assert np.abs(by_push - context.sim.residual((), windows)).max() > 0.01


def test_what_a_law_remembers_when_a_window_begins_is_what_was_measured_before():
    context, _ = begun(nothing)
    law = LearnedForce("axis", "a*lowpass(u, 0.1)", a=1.0)
    past = remembered(ActingForces(context.sim.model, [law]), context.sim.data, context.sim.commands.at_samples(()))
    r = context.sim.data[1]
    expected = np.zeros(len(r) + 1)
    for k in range(len(r)):
        expected[k + 1] = expected[k] + (1 - np.exp(-0.02 / 0.1)) * (r.actions[k, 0] - expected[k])
    np.testing.assert_allclose(past[1][:, 0], expected, atol=1e-9)


def test_terms_are_formulas_of_the_grammar_and_have_units():
    terms = dictionary(SIZES)
    assert len(terms) > 100
    for term in terms:
        assert all(parse_expression(text) for text in term.columns())
        assert len(term_units(term, hinge=True)) == term.size
    sum_of_two = [Term("A*sin(P*q) + B*cos(P*q)", "", (3.0,), ("/q",)), Term("A*v", "v")]
    assert write_law(sum_of_two) == "a*sin(c*q) + b*cos(c*q) + d*v"
    assert [u for t in sum_of_two for u in term_units(t, True)] == ["N·m", "N·m", "1/rad", "N·m·s/rad"]
    signals = ("motor motor motor", "motor motor", "motor motor v", "motor v", "load load q")
    powers = [Term(f"A*{x.replace(' ', '*')}", x) for x in signals]
    assert [term_units(t, True)[0] for t in powers] == [
        "1/(N·m)²", "1/(N·m)", "s/(N·m·rad)", "s/rad", "1/(N·m·rad)"
    ]  # fmt: skip
    assert term_units(powers[0], hinge=False) == ["1/N²"]


def test_no_law_is_what_an_effect_of_the_library_says():
    context, state = begun(viscous)
    found = search_laws(context, state)  # without a search for effects before
    assert context.loss(state.windows.held_out, state.effects).mean() > law_search.LEFT_OVER
    assert not laws_of(found.state) and found.network is None and found.places[0].follows == ("v",)


def test_a_formula_is_written_with_numbers():
    text = formula_in_numbers("a*abs(load)*tanh(v/b) + c*q**2", {"a": -0.353, "b": 0.0189, "c": -2.0})
    assert text == "-0.353·abs(load)·tanh(v/0.0189) - 2·q²"


def test_regression_gives_the_amplitudes_and_what_they_remove():
    rng = np.random.default_rng(0)
    X, x = rng.normal(size=(200, 2)), np.array([2.0, -1.0])
    found, gain = regress(X, -X @ x)
    np.testing.assert_allclose(found, x, atol=1e-4)
    assert gain == pytest.approx(np.square(X @ x).sum(), rel=1e-4)


def test_the_networks_slopes_are_its_derivatives_and_it_is_the_effect_that_is_simulated():
    rng = np.random.default_rng(1)
    x, w = rng.uniform(-1, 1, (4, 3, 2)), rng.normal(size=HIDDEN * 4 + 1)
    value, slope = network(x, w)
    for i in (0, HIDDEN * 2, HIDDEN * 3, len(w) - 1):
        moved = w + 1e-6 * (np.arange(len(w)) == i)
        np.testing.assert_allclose((network(x, moved)[0] - value) / 1e-6, slope[..., i], atol=1e-5)
    box = ResidualNetwork("axis", "q v", (1.0, 1.0), tuple(w), 2.0)
    signals = {"q": x[..., 0].ravel(), "v": x[..., 1].ravel()}
    np.testing.assert_allclose(box.force_from(signals, np.zeros((12, 0))), 2.0 * value.ravel(), atol=1e-12)


@pytest.mark.slow
def test_a_diagnosis_reports_a_law_and_leaves_it_out_on_request():
    spec, data = mujoco.MjSpec.from_string(PENDULUM), record(ripple)
    diagnosis = diagnose(spec, data, threads=1)
    laws = diagnosis.report["laws"]
    assert diagnosis.verdict.value == "unexplained_residual" and laws["found"][0]["depends_on"] == ["q", "u"]
    assert any(isinstance(e, LearnedForce) for e in diagnosis.effects)
    assert "laws" not in diagnose(spec, data, threads=1, laws=False).report


def test_only_the_amplitudes_of_a_law_are_said_to_be_zero_in_the_model():
    terms = [Term("A*sin(P*q) + B*cos(P*q)", "", (2.36,), ("/q",))]
    candidate, start = law_candidate(SIZES, terms, np.array([0.3, 0.1]), np.array([0.01, 0.01]))
    law = AcceptedEffect(0, candidate, start, interval=np.stack([start - 1, start + 1], 1))
    told = parameter_estimates(mujoco.MjModel.from_xml_string(PENDULUM), law)
    assert [p.nominal for p in told.values()] == [0.0, 0.0, None], "where its fit began is no number of the model"
    assert [p.estimate for p in told.values()] == [0.3, 0.1, 2.36]
    assert candidate.nominal == (0.0, 0.0, 2.36)


def test_coefficients_stay_within_what_a_law_can_have_however_weak_its_terms_are():
    sizes = JointSizes("axis", True, np.linspace(-1, 1, 7), 2.0, 1.0, 1.0, 0.02, "u")
    term = next(t for t in dictionary(sizes) if t.amplitudes == 1 and not t.inner)
    candidate, _ = law_candidate(sizes, [term], np.array([1e12]), np.array([1e20]))
    assert np.abs(candidate.effect([1e30]).a) <= 1e9


@pytest.mark.filterwarnings("error")
def test_a_term_that_never_acts_changes_nothing():
    """It once made every amplitude NaN, so that a law with it was never tried."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(50, 2))
    left = -X @ [1.0, -2.0] + 0.1 * rng.normal(size=50)
    x, gain = regress(X, left)
    with_idle, same = regress(np.column_stack([X, np.zeros(50)]), left)
    assert with_idle == pytest.approx([*x, 0.0]) and same == pytest.approx(gain)
    assert x == pytest.approx([1.0, -2.0], abs=0.1) and gain > 0.9 * left @ left
