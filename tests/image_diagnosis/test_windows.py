"""Effects found from images and actions: planted ones, none where nothing is planted, none that the sensor makes up."""

from contextlib import closing
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from datamodules import Episode, Trajectories, read_trajectories, write_trajectories
from idapt_pl.diagnosis.answer.result import ChannelError, EffectEstimate, ParameterEstimate
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.joints import JointDamping
from idapt_pl.effects.signals import SensorGain
from idapt_pl.envs import VectorStateEnv
from idapt_pl.image_diagnosis import discover_effects
from idapt_pl.image_diagnosis.calibration import GAIN_STD, Calibration, calibrate, familiar_frames, reliable_channels
from idapt_pl.image_diagnosis.forecasts import play_commands
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.image_diagnosis.settings import DiscoverySettings
from idapt_pl.image_diagnosis.windows import (
    WindowDiagnosis,
    beyond_the_control,
    drop_unconvincing,
    is_believable,
    is_sensor_error,
    is_within_noise,
)
from idapt_pl.tasks import make_task

LOOK_FOR = DiscoverySettings(True, candidates=("body_mass", "joint_damping"), max_effects=1)
RANGE = 2.0  # m or rad to either side


def picture(qpos):
    """Positions written into pixels, three digits of a number each: (n, nq) to (n, 1, nq, 3)."""
    number = np.clip((qpos + RANGE) / (2 * RANGE), 0, 1) * (256**3 - 1)
    digits = np.stack([number // 256**2, number // 256 % 256, number % 256], -1)
    return digits.astype(np.uint8)[:, None]


class Reader(torch.nn.Module):
    """Reads :func:`picture`, with noise, and with a gain on angles as a poor G would give it."""

    def __init__(self, gain=1.0):
        super().__init__()
        self.gain = gain
        self.parameter = torch.nn.Parameter(torch.zeros(()))

    def predict(self, stacks):
        digits = stacks[:, -1, 0].double()
        q = (digits * torch.tensor([256**2, 256, 1.0])).sum(-1) / (256**3 - 1) * 2 * RANGE - RANGE
        q = q + 1e-3 * torch.from_numpy(np.random.default_rng(len(q)).normal(size=q.shape))
        return torch.cat([q[:, :1], self.gain * q[:, 1:], torch.zeros_like(q)], -1)


class Identity:
    """What a sensor needs of a visual transformation."""

    @staticmethod
    def translate_episode(episode):
        return episode


def recorded(path, domain, seed, episodes=60, steps=12, states=False):
    """Images and actions of a pendulum under slow random pushes; states only where asked for, no rewards."""
    task, rng = make_task("inverted_pendulum"), np.random.default_rng(seed)
    model, made = domain.compile(), []
    data = mujoco.MjData(model)
    for _ in range(episodes):
        mujoco.mj_resetData(model, data)
        task.reset(model, data, rng)
        motion, actions = [task.state(model, data)], np.clip(rng.normal(size=(steps, 1)) + rng.normal(), -3, 3)
        for a in actions:
            data.ctrl[:] = a
            mujoco.mj_step(model, data, task.frame_skip)
            motion.append(task.state(model, data))
        motion = np.array(motion)
        seen = {"pixels": picture(motion[:, :2])} | ({"state": motion} if states else {})
        made.append(Episode(actions.astype(np.float32), seen))
    write_trajectories(path, Trajectories(tuple(made), 0.04, "test"))
    return path


class PictureEnv(VectorStateEnv):
    """Simulations that are seen as :func:`picture` shows them."""

    def _observe(self):
        obs = super()._observe()
        return obs | {"pixels": picture(obs["state"][:, :2])[:, None]}


def played(path, domain, seed, states=False):
    """As :func:`recorded`, but episodes begin and end as the task's do."""
    task, rng, made = make_task("inverted_pendulum"), np.random.default_rng(seed), []
    with closing(PictureEnv(task, domain)) as env:
        for k in range(40):
            commands = np.clip(rng.normal() + rng.normal(size=(25, 1)), -3, 3).astype(np.float32)
            state = play_commands(env, commands, 1000 * seed + k, lambda obs: obs["state"])[0]
            seen = {"pixels": picture(state[:, :2])} | ({"state": state} if states else {})
            made.append(Episode(commands[: len(state) - 1], seen))
    write_trajectories(path, Trajectories(tuple(made), 0.04, "test"))
    return path


def discover_in(tmp_path, *hidden, gain=1.0, options=LOOK_FOR, recorded=recorded):
    task = make_task("inverted_pendulum")
    source = task.domain("source")
    control = recorded(tmp_path / "control.h5", source, 1, states=True)
    target = recorded(tmp_path / "target.h5", source.with_effects(*hidden), 2)
    sensor = ImageSensor(Reader(gain), task, 3)
    make_env = lambda domain, n: PictureEnv(task, domain, n)  # noqa: E731
    return discover_effects(source, sensor, Identity(), [target], [control], options, 0, make_env)


def keys(effects):
    return [(e.name, e.target) for e in effects]


@pytest.mark.parametrize("hidden", [BodyMass("pole", 50.0), JointDamping("hinge", 8.0)])
def test_a_planted_effect_is_found(tmp_path, hidden):
    result = discover_in(tmp_path, hidden)
    (effect,) = result.effects
    assert (effect.name, effect.target) == (hidden.name, hidden.target)
    value, truth = (next(iter(e.to_dict()["parameters"].values())) for e in (effect, hidden))
    assert value == pytest.approx(truth, rel=0.1)
    assert result.after < 0.5 * result.before and not result.by_forecasts
    assert result.sensor_errors["position"] == pytest.approx([1e-3, 1e-3], rel=0.5)
    (low, high), gain = next(iter(result.estimates[0].parameters.values())).ci95, result.evidence.unknown_gain
    assert low < truth < high and high - low > gain * truth, "the interval allows for a gain of the sensor"


@pytest.mark.parametrize("gain", [1.0, 0.7])
@pytest.mark.parametrize("hidden", [(), (BodyMass("pole", 50.0),)])
def test_where_a_sensor_cannot_tell_how_fast_things_move_forecasts_decide(tmp_path, monkeypatch, hidden, gain):
    """The same effect, or nothing, also where angles are read too small, which is on both sides of a forecast."""
    monkeypatch.setattr("idapt_pl.image_diagnosis.calibration.VELOCITY_ERROR_LIMIT", 1e-3)
    result = discover_in(tmp_path, *hidden, gain=gain, recorded=played)
    assert result.by_forecasts and keys(result.effects) == keys(hidden)
    assert set(result.target) == {f"{joint}{what}" for joint in ("slider", "hinge") for what in ("", " velocity")}
    if hidden:
        mass = result.estimates[0].parameters["mass"]
        assert mass.estimate == pytest.approx(50.0, rel=0.1) and mass.ci95[0] < 50.0 < mass.ci95[1]
        assert result.after < 0.7 * result.before and result.explained > 0.7
    channels = result.evidence.example.channels
    assert list(channels) == ["slider", "hinge"]
    assert all(len(c.read) == len(c.before.mean) for c in channels.values())
    before, after = (
        sum(np.square(np.subtract(c.read, getattr(c, k).mean)).sum() for c in channels.values())
        for k in ("before", "after")
    )
    assert after < 0.5 * before if hidden else after == before


def test_two_planted_effects_are_found(tmp_path):
    hidden = BodyMass("pole", 50.0), JointDamping("slider", 20.0)
    result = discover_in(tmp_path, *hidden, options=replace(LOOK_FOR, max_effects=2))
    assert set(keys(result.effects)) == set(keys(hidden))
    assert result.rejected == result.negligible == ()


def estimate(effect, target="hinge", change=1.0):
    """As far as an estimate matters for whether to believe it."""
    return EffectEstimate(effect, target, {"x": ParameterEstimate(0.0, change, (0.0, 1.0), "1")}, {}, 1.0, 2.0, ())


def diagnosis(*effects, after, before=4.0):
    """One channel, in units in which the control's error is 1."""
    estimates = tuple(estimate(e.name, e.target) for e in effects)
    return WindowDiagnosis(effects, estimates, before, after, {"hinge": ChannelError(before, after, 1.0, "rad")})


MASS, DAMPING = BodyMass("pole", 50.0), JointDamping("hinge", 8.0)


@pytest.mark.parametrize(("after_both", "kept"), [(1.0, 2), (2.2, 2), (2.7, 1), (3.1, 1)])
def test_a_second_effect_must_say_enough_for_itself(after_both, kept):
    """The first leaves 3.2 of 4; half of what is beyond the control's 1 is 1.1, three tenths of all is 0.96."""
    made = {2: diagnosis(MASS, DAMPING, after=after_both), 1: diagnosis(MASS, after=3.2)}
    seen, negligible = drop_unconvincing(made.get, 2, diagnosis(before=1.0, after=1.0))
    assert len(seen.effects) == kept and [e.effect for e in negligible] == ["joint_damping"][: 2 - kept]


def test_one_effect_is_diagnosed_once():
    asked = []

    def diagnose_with(most):
        asked.append(most)
        return diagnosis(MASS, after=3.9)

    assert drop_unconvincing(diagnose_with, 2, diagnosis(before=1.0, after=1.0))[1] == () and asked == [2]


def test_nothing_is_found_where_nothing_is_planted(tmp_path):
    result = discover_in(tmp_path)
    assert result.effects == ()


def test_what_the_control_shows_too_is_not_believed(tmp_path):
    """A sensor that reads all angles 40 % too small makes something up, in the source as well."""
    result = discover_in(tmp_path, gain=0.6)
    assert result.effects == ()


def test_what_a_sensor_reads_belongs_to_its_frame_and_episode(tmp_path):
    """Stacks do not reach into the episode before, and readings stand beside the actions that were taken there."""
    path = recorded(tmp_path / "d.h5", make_task("inverted_pendulum").domain("source"), 3, episodes=3)
    read = ImageSensor(Reader(), make_task("inverted_pendulum"), 3).read([path])
    for there, here in zip(read_trajectories(path), read, strict=True):
        assert np.array_equal(there.actions, here.actions)
        again = Reader().predict(torch.from_numpy(there.observations["pixels"][:, None])).numpy()[:, :2]
        assert here.observations["qpos"] == pytest.approx(again, abs=1e-2)


def test_what_is_found_in_the_control_counts_by_how_much_of_it_there_is():
    def delay(seconds, target="slide"):
        return estimate("actuator_delay", target, seconds)

    assert is_sensor_error(delay(0.04), [delay(0.03)]) and not is_sensor_error(delay(0.04), [delay(0.01)])
    assert not is_sensor_error(delay(0.04), [delay(0.04, "elsewhere")]) and not is_sensor_error(delay(0.04), [])


@pytest.mark.parametrize(
    ("intervals", "doubtful"),
    [
        ([(0.02, 1.18)], True),  # a motor's gain that was once believed
        ([(0.53, 0.66)], False),
        ([(1.0, 1.18)], False),
        ([None], False),
        ([(0.02, 1.18), (0.53, 0.66)], False),
        ([(0.02, 1.18), (0.9, 1.1)], True),
    ],
)
def test_within_noise_an_effect_whose_interval_holds_what_the_model_has_is_not_believed(intervals, doubtful):
    parameters = {str(i): ParameterEstimate(1.0, 0.6, ci95, "1") for i, ci95 in enumerate(intervals)}
    found = EffectEstimate("actuator_gain", "motor", parameters, {}, 1.0, 2.0, ())
    assert is_within_noise(found, 0.55) is doubtful
    assert not is_within_noise(found, 1.5), "there is something to explain"


def test_a_sensor_is_calibrated_on_frames_of_known_state(tmp_path):
    """Its errors come out in each joint's unit; velocities that it does not read (here: zeros) are not compared."""
    task = make_task("inverted_pendulum")
    path = recorded(tmp_path / "d.h5", task.domain("source"), 3, states=True)
    model, states = task.domain("source").compile(), read_trajectories(path)
    angle = np.concatenate([e.observations["state"][:, 1] for e in states])
    read = ImageSensor(Reader(gain=0.6), task, 3).read([path], Identity())
    found = calibrate(task, model, read)
    assert found.position[0] == pytest.approx(1e-3, rel=0.3)  # a few draws of noise, repeated in every episode
    assert found.position[1] == pytest.approx(0.4 * np.sqrt(np.mean(angle**2)), rel=0.05)
    speeds = np.concatenate([e.observations["state"][:, 2:] for e in states])
    assert found.velocity == pytest.approx(np.sqrt(np.mean(speeds**2, 0)), rel=1e-6)
    assert not found.reads_velocities and set(reliable_channels(read, found).episodes[0].observations) == {"qpos"}
    assert found.noise(model, ()).start == pytest.approx(np.concatenate([found.position, found.slope]))


def swings(n=40, T=50, seed=0):
    """Episodes of the pendulum's states, one sine each, as a sensor without errors reads them."""
    rng, episodes = np.random.default_rng(seed), []
    for _ in range(n):
        phase = rng.uniform(0, 2 * np.pi, 2) + np.linspace(0, 4, T + 1)[:, None]
        qpos, qvel = np.sin(phase) * (0.05, 0.1), np.cos(phase) * (0.05, 0.1) * 4 / (T * 0.04)
        seen = {"qpos": qpos, "qvel": qvel, "state": np.concatenate([qpos, qvel], 1)}
        episodes.append(Episode(np.zeros((T, 1), np.float32), seen))
    return Trajectories(tuple(episodes), 0.04)


def misread(data, change):
    """The same, with ``change(qpos, qvel)`` as the positions that were read."""
    seen = (e.observations for e in data)
    return replace(data, episodes=tuple(
        replace(e, observations=o | {"qpos": change(o["qpos"], o["qvel"])}) for e, o in zip(data, seen, strict=True)
    ))  # fmt: skip


def test_bias_and_lag_of_a_sensor_are_measured():
    task = make_task("inverted_pendulum")
    read = misread(swings(), lambda qpos, qvel: np.array([0.01, -0.02]) + qpos - 0.03 * qvel)
    found = calibrate(task, task.domain("source").compile(), read)
    assert found.bias == pytest.approx([0.01, -0.02], abs=1e-3) and found.lag == pytest.approx([0.03, 0.03], rel=0.02)


def test_frames_unlike_those_a_sensor_learned_from_are_left_out():
    """A cart far out is not readable: the episode ends there, and goes on after it with the right actions."""
    task = make_task("inverted_pendulum")
    model, known = task.domain("source").compile(), swings()
    out = np.zeros((51, 2))
    out[20:25, 0] = 0.5
    read = misread(swings(3, seed=1), lambda qpos, qvel: qpos + out)
    numbered = tuple(replace(e, actions=np.arange(50, dtype=np.float32)[:, None]) for e in read)
    kept = familiar_frames(task, model, replace(read, episodes=numbered), known)
    assert [len(e) for e in kept] == [19, 25] * 3
    assert [e.actions[[0, -1], 0].tolist() for e in kept][:2] == [[0, 18], [25, 49]]
    assert kept.episodes[1].observations["qpos"] == pytest.approx(read.episodes[0].observations["qpos"][25:])
    assert [len(e) for e in familiar_frames(task, model, known, known)] == [50] * 40
    everywhere = misread(known, lambda qpos, qvel: qpos + 0.5)
    assert familiar_frames(task, model, everywhere, known) is everywhere


def test_joints_that_no_state_tells_leave_no_frame_out():
    task = make_task("half_cheetah")
    model = task.domain("source").compile()
    states = np.random.default_rng(0).normal(0, 0.1, (200, 17))
    qpos, qvel = task.motion(states, 0.02)
    known = Trajectories((Episode(np.zeros((199, 6)), {"qpos": qpos, "qvel": qvel, "state": states}),), 0.02)
    far = misread(known, lambda qpos, qvel: qpos + np.eye(9)[0] * 100)
    assert familiar_frames(task, model, far, known).episodes[0].observations["qpos"][0, 0] > 90


def test_no_error_is_told_of_a_position_that_no_state_tells():
    task = make_task("half_cheetah")
    errors = Calibration(*(np.full(9, x) for x in (0.1, 0.2, 0.3, 9.0, 0.4, 0.5))).to_dict(
        task.domain("source").compile(), task.unseen
    )
    assert errors["position"] == [None, *[0.1] * 8] and errors["lag"][0] is None and errors["bias"][0] is None
    assert errors["velocity"] == [0.2] * 9


def test_velocities_are_compared_where_they_are_read_well():
    """Nearer to the truth than slopes, and not mostly what is likely in the source."""
    model = make_task("inverted_pendulum").domain("source").compile()
    good, poor = (Calibration(*(np.full(2, x) for x in (0.1, 0.2, 0.5, s, 0.0, 0.0))) for s in (1.0, 0.5))
    assert poor.velocities_unreliable and not poor.reads_velocities and not good.velocities_unreliable
    assert poor.noise(model, ()).sensors == pytest.approx([0.1, 0.1])
    assert poor.noise(model, ()).start == pytest.approx([0.1, 0.1, 0.5, 0.5])
    assert good.reads_velocities and good.noise(model, ()).sensors == pytest.approx([0.1, 0.1, 0.2, 0.2])
    assert good.noise(model, ["slider"]).systematic == (SensorGain("hinge", 1 + GAIN_STD),)


def test_what_is_beyond_the_control_is_measured_where_it_is_most():
    def errors(**channels):
        return {name: ChannelError(*values, 1.0, "1") for name, values in channels.items()}

    control, target = errors(x=(1.0, 0.9), angle=(2.0, 2.0)), errors(x=(1.2, 1.2), angle=(6.0, 3.0))
    assert beyond_the_control(target, control) == (3.0, 0.75)
    assert beyond_the_control(control, control)[1] == 0


@pytest.mark.parametrize(
    ("excess", "explained", "removed", "removed_in_control", "expected"),
    [
        (3.1, 0.6, 0.2, 0.0, True),  # much larger than in the control, and half of that goes
        (2.1, 0.6, 0.2, 0.0, False),
        (2.1, 0.95, 0.2, 0.0, True),  # larger, and nearly all of that goes
        (1.2, 0.9, 0.4, 0.0, True),  # calm motions, read better than the control's
        (1.2, 0.9, 0.4, 0.25, False),  # a search in the control takes as much away
        (1.2, 0.9, 0.15, 0.0, False),
    ],
)
def test_what_is_believed(excess, explained, removed, removed_in_control, expected):
    assert is_believable(excess, explained, removed, removed_in_control) is expected


def test_the_share_of_an_error_that_goes():
    assert diagnosis(before=4.0, after=3.0).removed_share == 0.25
    assert diagnosis(before=0.0, after=0.0).removed_share == 0.0
