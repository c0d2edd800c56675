"""`idapt import --model` with a URDF: its order, its limits, and actuators that the user declares."""

import numpy as np
import pytest
import yaml
from test_import import run, write_csv

from datamodules import read_trajectories

LINK = (
    '<link name="{}"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    "</inertial></link>"
)
URDF = f"""<robot name="arm"><link name="base"/>{LINK.format("upper")}{LINK.format("lower")}
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="5" velocity="3"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><axis xyz="0 1 0"/>
  <limit effort="2" velocity="3"/></joint></robot>"""
MAP = {
    "time": "t",
    "joints": {"elbow": {"position": "e"}, "shoulder": {"position": "s"}},
    "actuators": {"elbow": "tau_e", "shoulder": "tau_s"},
}
"""Not in the model's order."""


@pytest.fixture
def arm(tmp_path):
    """Imports a recording of the arm; exit code, what was printed, and the recording."""
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)

    def load(capsys, *options, mapping=MAP, **columns):
        t = np.arange(40) * 0.01
        table = {
            "t": t,
            "s": 0.5 * np.sin(t),
            "e": np.cos(t),
            "tau_s": np.sin(9 * t),
            "tau_e": -np.sin(9 * t),
        } | columns
        csv, out = write_csv(tmp_path / "run.csv", table), tmp_path / "run.h5"
        (tmp_path / "map.yaml").write_text(yaml.safe_dump(mapping))
        arguments = ["import", csv, "--map", tmp_path / "map.yaml", "--model", path, "--out", out, *options]
        code, printed = run(arguments, capsys)
        return code, " ".join((printed.out + printed.err).split()), read_trajectories(out) if out.exists() else None

    return load


def test_columns_are_put_in_the_order_of_the_urdf(arm, capsys):
    code, printed, data = arm(capsys, "--actuators", "motor")
    assert code == 0 and "note" not in printed
    (episode,) = data
    t = np.arange(40) * 0.01
    np.testing.assert_allclose(episode.observations["qpos"], np.column_stack([0.5 * np.sin(t), np.cos(t)]), atol=1e-9)
    np.testing.assert_allclose(episode.actions[:, 0], np.sin(9 * t)[:-1], atol=1e-6)


def test_without_actuators_a_command_needs_one_declared(arm, capsys):
    code, printed, _ = arm(capsys)
    assert code == 1 and "it has no actuators; say what drives it, --actuators motor" in printed
    undriven = {k: v for k, v in MAP.items() if k != "actuators"}
    assert arm(capsys, mapping=undriven)[0] == 0


def test_an_angle_in_degrees_and_one_beyond_the_limits_are_told_by_the_urdfs_limits(arm, capsys):
    code, printed, _ = arm(capsys, "--actuators", "motor", s=np.linspace(-30, 30, 40))
    assert code == 1 and "joint shoulder moves over 60 rad, over 10 times its range in" in printed
    code, printed, _ = arm(capsys, "--actuators", "motor", s=np.linspace(0, 1.5, 40))
    assert code == 0 and "joint shoulder goes from 0 to 1.5 rad, beyond its range in" in printed
    code, printed, _ = arm(capsys, "--actuators", "motor", e=np.linspace(0, 360, 40))
    assert code == 0 and "joint elbow moves over 360 rad, 57.3 turns" in printed, "it has no position limits"


def test_a_torque_beyond_the_urdfs_effort_limit_is_told(arm, capsys):
    code, printed, _ = arm(capsys, "--actuators", "motor", tau_e=np.linspace(-3, 3, 40))
    assert code == 0 and "actuator elbow is commanded -3 to 2.846" in printed
    assert "beyond its control range -2 to 2, where MuJoCo clamps it" in printed and "actuator shoulder" not in printed
    code, printed, _ = arm(capsys, "--actuators", "position:kp=30,kv=1", tau_e=np.linspace(-3, 3, 40))
    assert code == 0 and "is commanded" not in printed, "an effort is no limit of angles"


def test_a_name_that_the_urdf_has_not_and_a_broken_urdf_are_clear_errors(arm, capsys, tmp_path):
    wrong = MAP | {"joints": {"elbo": {"position": "e"}, "shoulder": {"position": "s"}}}
    code, printed, _ = arm(capsys, "--actuators", "motor", mapping=wrong)
    assert code == 1 and "joints.elbo" in printed and "did you mean 'elbow'?" in printed
    (tmp_path / "arm.urdf").write_text(URDF[:300])
    code, printed, _ = arm(capsys, "--actuators", "motor")
    assert code == 1 and "arm.urdf: cannot be read as URDF" in printed
