"""Recordings are checked against the model, and cut into windows."""

import mujoco
import numpy as np
import pytest
from arm import ARM, DT, record, right_model

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.prediction.data import UnusableData, as_recordings


def test_windows_stay_inside_episodes_and_do_not_overlap():
    sim, windows, *_ = right_model()
    for e in np.unique(windows.episode):
        starts = np.sort(windows.start[windows.episode == e])
        assert starts[-1] + windows.offsets[-1] <= len(sim.data[e])
        assert (np.diff(starts) >= windows.offsets[-1]).all()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda q, a: (q[:, :1], a), r"episode_0: qpos has shape \(81, 1\), but the model has 2"),
        (lambda q, a: (np.where(np.arange(81)[:, None] == 7, np.nan, q), a), "qpos holds NaN .* first in row 7"),
        (
            lambda q, a: (np.where(np.arange(81)[:, None] == 7, [0, 2e12], q), a),
            r"2e\+12 in column 1, row 7",
        ),
        (lambda q, a: (q, a[:, :1]), r"actions has shape \(80, 1\), but the model has 2 actuators"),
    ],
    ids=["shape", "nan", "absurd", "actions"],
)
def test_unusable_recordings_are_refused_by_name(spoil, message):
    good = record(episodes=2)
    e = good.episodes[0]
    qpos, actions = spoil(e.observations["qpos"], e.actions)
    bad = Episode(actions, {"qpos": qpos, "qvel": e.observations["qvel"]})
    with pytest.raises(UnusableData, match=message):
        diagnose(mujoco.MjSpec.from_string(ARM), Trajectories((bad, *good.episodes[1:]), DT))


def test_velocities_that_come_late_are_not_used():
    """A filtered speed register would otherwise be blamed on friction or on a sensor."""
    prompt = record()
    late = [
        Episode(e.actions, {**e.observations, "qvel": e.observations["qvel"][[0, 0, *range(80 - 1)]]})
        for e in prompt.episodes
    ]
    model = mujoco.MjModel.from_xml_string(ARM)
    assert as_recordings(model, prompt)[1], "prompt velocities are used"
    assert not as_recordings(model, Trajectories(tuple(late), DT))[1]


@pytest.mark.parametrize("late", [0, 1])
def test_velocities_of_a_simulation_with_steps_as_long_as_its_control_steps_are_used(late):
    """Semi-implicit Euler's velocity is the mean one of the step before: half a control period late, as the model's."""
    coarse = ARM.replace('timestep="0.004"', f'timestep="{DT}"')
    told = record(coarse, noise=(1e-5, 1e-4), skip=1)
    rows = [*[0] * late, *range(81 - late)]
    shifted = [Episode(e.actions, {**e.observations, "qvel": e.observations["qvel"][rows]}) for e in told.episodes]
    model = mujoco.MjModel.from_xml_string(coarse)
    assert as_recordings(model, Trajectories(tuple(shifted), DT))[1] is not bool(late)
