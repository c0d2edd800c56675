"""Forecasts of what a sensor reads: a proper score, the same resets for all, planted effects found and no others."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from datamodules import Episode
from idapt_pl.effects.actuators import ActuatorBias
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointDamping
from idapt_pl.envs import VectorStateEnv
from idapt_pl.estimation.energy import energy_score
from idapt_pl.image_diagnosis.forecast_diagnosis import first_judged, of_one_parameter
from idapt_pl.image_diagnosis.forecast_search import bracket_minimum, evaluate_at, first_values, refine_estimate
from idapt_pl.image_diagnosis.forecasts import Forecaster, ObservedStart, pad_with_last, play_commands
from idapt_pl.image_diagnosis.parabola import SYSTEMATIC_LOG_STD, parabola_minimum
from idapt_pl.tasks import make_task

TASK = make_task("inverted_pendulum")
SOURCE = TASK.domain("source")


def state(obs):
    return obs["state"]


def test_energy_score_of_two_members_by_hand():
    """y = 1, X = 0 and 3: E|X - y| = 1.5, ½ E|X - X'| = 1.5; the first moment does not count."""
    members, observed = np.array([[[9.0], [0.0]], [[5.0], [3.0]]]), np.array([[7.0], [1.0]])
    assert energy_score(members, observed) == pytest.approx(0.0)
    assert energy_score(members, np.array([[7.0], [5.0]])) == pytest.approx(2.0)


@pytest.mark.parametrize(("shift", "width"), [(0.5, 1.0), (0.0, 2.0), (0.0, 0.3)])
def test_the_score_is_proper(shift, width):
    """The distribution that was drawn from scores best: not one beside it, nor a wider or a narrower one."""
    rng = np.random.default_rng(0)
    y = rng.normal(size=(4000, 1, 2, 3))

    def mean_score(shift, width):
        x = shift + width * rng.normal(size=(4000, 4, 2, 3))
        return np.mean([energy_score(m, o[0]) for m, o in zip(x, y, strict=True)])

    assert mean_score(shift, width) > mean_score(0.0, 1.0) + 0.03


def test_commands_are_played_from_the_same_resets_whatever_the_domain():
    commands = np.full((30, 1), 0.5, np.float32)
    shown = []
    for domain in (SOURCE, SOURCE.with_effects(BodyMass("pole", 200.0))):
        with closing(VectorStateEnv(TASK, domain, 3)) as env:
            shown.append(play_commands(env, commands, 5, state))
    light, heavy = shown
    for a, b in zip(light, heavy, strict=True):
        assert np.array_equal(a[0], b[0]), "resets"
        assert not np.allclose(a[3], b[3]), "motions"
    assert len({tuple(a[0]) for a in light}) == 3, "members differ"
    assert all(len(a) <= 31 for a in light) and min(len(a) for a in light) < 31, "a pushed pole falls"


def test_what_was_over_before_stays_as_it_was():
    assert pad_with_last(np.array([[1.0], [2.0]]), 4).tolist() == [[1.0], [2.0], [2.0], [2.0]]


def pendulum_forecasts(hidden, count=12):
    """States themselves are what is read."""
    rng, seen = np.random.default_rng(0), []
    with closing(VectorStateEnv(TASK, SOURCE.with_effects(*hidden))) as env:
        for k in range(count):
            commands = rng.uniform(-3, 3, (10, 1)).astype(np.float32)
            read = play_commands(env, commands, 100 + k, state)[0]
            seen.append(ObservedStart(commands[: len(read) - 1], read))
    return Forecaster(tuple(seen), lambda d: VectorStateEnv(TASK, d, 4), state, lambda x, a: x, np.ones(4))


@pytest.mark.parametrize("mass", [50.0, 200.0])
def test_the_right_dynamics_forecast_best(mass):
    forecasts = pendulum_forecasts((BodyMass("pole", mass),))
    tried = (SOURCE.with_effects(BodyMass("pole", m)) for m in (0.5 * mass, mass, 2 * mass))
    scores = [forecasts.scores(d, 0).mean() for d in (SOURCE, *tried)]
    assert np.argmin(scores) == 2, scores
    assert len(forecasts.scores(SOURCE, 0, 3)) == 3
    assert np.array_equal(forecasts.scores(SOURCE, 0), forecasts.scores(SOURCE, 0)), "one seed, one score"
    assert forecasts.errors_of(forecasts.ensembles(SOURCE, 0)).shape == (4,)


def test_what_pairs_show_of_the_source_is_not_judged():
    """As G shows it: what the source did in the first steps, as what the target did."""
    seen, own, paired = pendulum_forecasts((BodyMass("pole", 200.0),)), pendulum_forecasts(()), 4
    starts = tuple(
        replace(s, read=np.concatenate([o.read[:paired], s.read[paired:]]))
        for s, o in zip(seen.starts, own.starts, strict=True)
        if min(len(s.read), len(o.read)) > paired + 2
    )
    masses = (4.895, 100.0, 200.0, 400.0)
    worlds = [SOURCE.with_effects(BodyMass("pole", m)) for m in masses]
    after = replace(seen, starts=starts, begin=paired)
    scores = np.array([after.scores(d, 0).mean() for d in worlds])
    assert masses[scores.argmin()] == 200.0, scores
    whole = np.array([replace(after, begin=0).scores(d, 0).mean() for d in worlds])
    assert scores[2] / scores[0] < whole[2] / whole[0], "the pairs make it look less wrong without"
    played = after.ensembles(worlds[2], 0)
    left = np.concatenate([(x.mean(0) - s.read)[paired + 1 :] for x, s in zip(played, starts, strict=True)])
    assert after.errors_of(played) == pytest.approx(np.sqrt(np.square(left).mean(0)))


def lasting(*steps):
    return [Episode(np.zeros((n, 1), np.float32), {"pixels": np.zeros((n + 1, 2, 2, 3), np.uint8)}) for n in steps]


@pytest.mark.parametrize(
    ("target", "control", "begin"), [((30, 26, 8), (30, 30), 20), ((30, 25, 8), (30, 30), 0), ((30, 30), (30, 8), 0)]
)
def test_where_too_few_episodes_outlast_the_pairs_all_steps_are_judged(target, control, begin, caplog):
    assert first_judged(20, lasting(*target), lasting(*control)) == begin
    assert ("all are judged" in caplog.text) == (begin == 0)


class Valley:
    """Scores with their lowest point at a pole of 80 kg, in the logarithm, a little elsewhere for each episode."""

    lowest = np.log(80.0) + 0.1 * np.linspace(-1, 1, 12)

    def scores(self, domain, seed):
        mass = float(domain.compile().body("pole").mass[0])
        return 1.0 + np.square(np.log(mass) - self.lowest)


def pole():
    """The pole's mass as a candidate."""
    return Candidate(BodyMass, "pole", ("mass",), (4.895,), (1.0,))


@pytest.mark.parametrize("start", [50.0, 80.0, 150.0])
def test_an_estimate_goes_to_the_lowest_point_and_its_interval_knows_of_episodes_and_of_G(start):
    valley = Valley()
    found = refine_estimate(
        SOURCE, bracket_minimum(SOURCE, evaluate_at(SOURCE, pole(), start, valley, 0), valley, 0), valley, 0
    )
    assert found.x == pytest.approx(80.0, rel=0.01)
    of_a_mean = 2.201 * Valley.lowest.std(ddof=1) / np.sqrt(12)  # Student's t, 11 degrees of freedom
    half = np.hypot(of_a_mean, 1.96 * SYSTEMATIC_LOG_STD)
    assert np.log(found.interval) == pytest.approx(np.log(found.x) + np.array([-half, half]), rel=0.01)


def test_a_value_below_zero_is_looked_for_too():
    """Commands that are shifted down."""

    class Shifted:
        def scores(self, domain, seed):
            shift = sum(e.bias for e in domain.effects if e.name == "actuator_bias")
            return 1.0 + np.square(np.log(max(-shift, 1e-3) / 0.4)) + 0.01 * np.linspace(-1, 1, 12)

    bias = Candidate(ActuatorBias, "slide", ("bias",), (0.0,), (0.5,))
    assert [x for x in first_values(bias) if x < 0] == pytest.approx([-1.5, -0.5, -0.15])
    start = evaluate_at(SOURCE, bias, -0.5, Shifted(), 0)
    found = refine_estimate(SOURCE, bracket_minimum(SOURCE, start, Shifted(), 0), Shifted(), 0)
    assert found.x == pytest.approx(-0.4, rel=0.01) and found.interval[0] < found.x < found.interval[1] < 0


def test_no_interval_where_the_lowest_point_is_beyond_what_was_tried():
    class Slope(Valley):
        def scores(self, domain, seed):
            return np.full(12, np.log(domain.compile().body("pole").mass[0]))

    found = refine_estimate(
        SOURCE, bracket_minimum(SOURCE, evaluate_at(SOURCE, pole(), 80.0, Slope(), 0), Slope(), 0), Slope(), 0
    )
    assert found.interval is None and found.x < 50


def test_a_parabola_goes_a_stride_beyond_what_was_tried_and_not_further():
    x = np.array([0.0, 0.4, 0.8])
    assert parabola_minimum(x, np.square(x - 0.3)) == (pytest.approx(0.3), True)
    assert parabola_minimum(x, np.square(x - 1.0)) == (pytest.approx(1.0), False)
    assert parabola_minimum(x, np.square(x - 9.0)) == (pytest.approx(1.2), False)
    assert parabola_minimum(x, -x) == (pytest.approx(1.2), False), "no bend"
    assert parabola_minimum(np.array([0.0, 0.0, 0.4]), np.array([1.0, 1.0, 2.0])) == (0.0, False), "at a bound"


def test_effects_of_several_parameters_are_an_error_that_names_them():
    two = Candidate(JointDamping, "hinge", ("damping", "other"), (0.0, 0.0), (1.0, 1.0))
    with pytest.raises(ValueError, match="joint_damping has several parameters"):
        of_one_parameter([pole(), two])
    assert of_one_parameter([pole(), replace(two, kind=BodyMass)]) == [pole()]


def test_first_values_are_on_both_sides_and_inside_the_bounds():
    assert first_values(pole())[0] == pytest.approx(0.4 * 4.895) and first_values(pole())[-1] == pytest.approx(
        8 * 4.895
    )
    damping = Candidate(JointDamping, "hinge", ("damping",), (0.0,), (2.0,))
    assert first_values(damping) == pytest.approx([0.6, 2.0, 6.0])
