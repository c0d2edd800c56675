"""Floating bodies in other axes than MuJoCo's: a flight is the same whichever way it was written down."""

import mujoco
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from test_draft_map import drafted
from test_import import write_csv

from cli.import_ import import_recordings, read_layout
from datamodules.recordings import RecordingError, fit_to_model, parse_mapping

DRONE = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody><body><freejoint name="root"/>
    <geom type="box" size="0.1 0.2 0.05" mass="1"/><site name="left" pos="0 0.2 0"/><site name="right" pos="0 -0.2 0"/>
  </body></worldbody>
  <actuator><motor name="left" site="left" gear="0 0 1 0 0 0.02" ctrlrange="0 8" ctrllimited="true"/>
    <motor name="right" site="right" gear="0 0 1 0 0 -0.02" ctrlrange="0 8" ctrllimited="true"/></actuator>
</mujoco>"""
NAMES = ("x", "y", "z", "qw", "qx", "qy", "qz"), ("vx", "vy", "vz", "wx", "wy", "wz")
UP, DOWN = np.eye(3), np.diag([1.0, -1.0, -1.0])
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Coordinates with z down, and with y up, of what has coordinates with z up."""


@pytest.fixture(scope="module")
def flight():
    """States that MuJoCo makes, every 10 ms: times, qpos (n, 7), qvel (n, 6) and commands (n, 2)."""
    model = mujoco.MjModel.from_xml_string(DRONE)
    data = mujoco.MjData(model)
    data.qpos[2], data.qvel[:] = 3.0, (0.5, -0.3, 1.0, 0.4, -0.8, 1.2)
    rows, commands = [], []
    for k in range(150):
        u = np.array([5 + np.sin(0.1 * k), 5 - np.sin(0.1 * k)])
        rows.append(np.concatenate([[data.time], data.qpos, data.qvel]))
        commands.append(u)
        data.ctrl[:] = u
        for _ in range(5):
            mujoco.mj_step(model, data)
    rows = np.array(rows)
    return rows[:, 0], rows[:, 1:8], rows[:, 8:], np.array(commands)


def as_written(flight, world=UP, body=UP, linear="world", angular="body"):
    """The flight's columns by name: coordinates ``world @ x`` and ``body @ b`` of MuJoCo's x and b."""
    times, qpos, qvel, commands = flight
    turned = Rotation.from_quat(np.roll(qpos[:, 3:], -1, axis=1)).as_matrix()
    rotation = world @ turned @ body.T
    quaternions = np.roll(Rotation.from_matrix(rotation).as_quat(), 1, axis=1)
    velocity, rate = qvel[:, :3] @ world.T, qvel[:, 3:] @ body.T
    if linear == "body":
        velocity = np.einsum("nji,nj->ni", rotation, velocity)
    if angular == "world":
        rate = np.einsum("nij,nj->ni", rotation, rate)
    motion = np.hstack([qpos[:, :3] @ world.T, quaternions, velocity, rate])
    return {"t": times, **dict(zip(sum(NAMES, ()), motion.T, strict=True)), "a": commands[:, 0], "b": commands[:, 1]}


def mapped(axes=None, order=NAMES[0]):
    joint = {"position": {"column": list(order)}, "velocity": {"column": list(NAMES[1])}}
    joint |= {} if axes is None else {"axes": axes}
    return {"time": "t", "joints": {"root": joint}, "actuators": {"left": "a", "right": "b"}}


def imported(columns, content, tmp_path):
    (tmp_path / "drone.xml").write_text(DRONE)
    path, layout = write_csv(tmp_path / "flight.csv", columns), read_layout(tmp_path / "drone.xml")
    return import_recordings([path], fit_to_model(parse_mapping(content), layout), layout)


@pytest.mark.parametrize(
    ("written", "axes"),
    [
        ({}, None),
        ({"world": DOWN, "body": DOWN}, {"world": "ned", "body": "frd"}),
        ({"world": DOWN, "linear": "body"}, {"world": "z_down", "linear": "body"}),
        ({"linear": "body"}, {"linear": "body", "body": "flu"}),
        ({"world": Y_UP, "body": Y_UP, "angular": "world"}, {"world": "y_up", "body": "y_up", "angular": "world"}),
    ],
)
def test_a_flight_is_the_same_in_whatever_axes(written, axes, flight, tmp_path):
    made = imported(as_written(flight, **written), mapped(axes), tmp_path)
    (episode,) = made.trajectories
    _, qpos, qvel, _ = flight
    same = np.sign(np.sum(episode.observations["qpos"][:, 3:] * qpos[:, 3:], axis=1))[:, None]  # q and -q are one
    np.testing.assert_allclose(episode.observations["qpos"][:, :3], qpos[:, :3], atol=1e-12)
    np.testing.assert_allclose(same * episode.observations["qpos"][:, 3:], qpos[:, 3:], atol=1e-12)
    np.testing.assert_allclose(episode.observations["qvel"], qvel, atol=1e-12)
    assert not any("slope" in note or "quaternion" in note for note in made.notes)
    assert (axes is None) or any("turned into MuJoCo's" in note for note in made.notes)


def in_angles(columns, degrees=True, pitch=1):
    """The same with roll, pitch and yaw in place of the quaternion: yaw about z first, as aircraft have them."""
    quaternions = np.column_stack([columns[name] for name in ("qx", "qy", "qz", "qw")])
    yaw, tilt, roll = Rotation.from_quat(quaternions).as_euler("ZYX", degrees=degrees).T
    return {**columns, "roll": roll, "pitch": pitch * tilt, "yaw": yaw}


@pytest.mark.parametrize(
    ("written", "axes", "pitch"),
    [
        ({}, {"angles": "deg"}, 1),
        ({"world": DOWN, "body": DOWN}, {"world": "ned", "body": "frd", "angles": "deg"}, 1),
        ({"linear": "body"}, {"linear": "body", "angles": "deg", "pitch": "reversed"}, -1),
    ],
)
def test_roll_pitch_and_yaw_are_the_same_flight(written, axes, pitch, flight, tmp_path):
    columns = in_angles(as_written(flight, **written), pitch=pitch)
    columns |= {name: np.degrees(columns[name]) for name in ("wx", "wy", "wz")}
    content = mapped({**axes, "rates": "deg/s"}, order=("x", "y", "z", "roll", "pitch", "yaw"))
    made = imported(columns, content, tmp_path)
    (episode,) = made.trajectories
    _, qpos, qvel, _ = flight
    same = np.sign(np.sum(episode.observations["qpos"][:, 3:] * qpos[:, 3:], axis=1))[:, None]
    np.testing.assert_allclose(same * episode.observations["qpos"][:, 3:], qpos[:, 3:], atol=1e-9)
    np.testing.assert_allclose(episode.observations["qvel"], qvel, atol=1e-9)
    assert not any("slope" in note for note in made.notes)


def test_rates_in_degrees_are_asked_about(flight, tmp_path):
    columns = in_angles(as_written(flight))
    columns |= {name: np.degrees(columns[name]) for name in ("wx", "wy", "wz")}
    content = mapped({"angles": "deg"}, order=("x", "y", "z", "roll", "pitch", "yaw"))
    notes = [note for note in imported(columns, content, tmp_path).notes if "slope" in note]
    assert len(notes) == 1 and "angular velocity is 57" in notes[0] and "rates?" in notes[0]


def test_quaternions_do_not_jump(flight, tmp_path):
    columns = as_written(flight, world=DOWN, body=DOWN)
    flipped = np.where(np.arange(len(columns["t"])) % 7 < 3, -1, 1)
    columns |= {name: flipped * columns[name] for name in NAMES[0][3:]}
    (episode,) = imported(columns, mapped({"world": "ned", "body": "frd"}), tmp_path).trajectories
    assert np.abs(np.diff(episode.observations["qpos"][:, 3:], axis=0)).max() < 0.1


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ({"linear": "body"}, "linear velocity is not the slope of the positions: is it in the body's axes"),
        ({"angular": "world"}, "angular velocity is not the slope of the positions: is it in the world's axes"),
        ({"world": DOWN, "body": DOWN}, None),  # nothing but gravity tells
    ],
)
def test_velocities_in_other_axes_are_asked_about(written, said, flight, tmp_path):
    notes = imported(as_written(flight, **written), mapped(), tmp_path).notes
    assert [said in note for note in notes if "slope" in note] == ([] if said is None else [True])


def test_a_quaternion_in_another_order_is_asked_about(flight, tmp_path):
    notes = imported(as_written(flight), mapped(order=("x", "y", "z", "qx", "qy", "qz", "qw")), tmp_path).notes
    assert any("recorded as x, y, z, w?" in note for note in notes)


def test_one_axis_of_velocities_turned_is_asked_about(flight, tmp_path):
    columns = as_written(flight)
    columns |= {name: -columns[name] for name in ("vy", "vz", "wy", "wz")}
    notes = [note for note in imported(columns, mapped(), tmp_path).notes if "slope" in note]
    assert len(notes) == 2 and all("does z point down in one of them?" in note for note in notes)


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ({"world": "nde"}, r"joints.root.axes.world: got 'nde'; did you mean 'ned'"),
        ({"wold": "ned"}, r"joints.root.axes: unknown key 'wold'; did you mean 'world'"),
        ("ned", r"joints.root.axes: expected keys among world, body, linear, angular, rates, angles, pitch; got 'ned'"),
        (
            {"angles": "rad"},
            r"joints.root.axes: axes are of .*, which take 3 or 6 columns with roll, pitch and yaw; got 1",
        ),
    ],
)
def test_mistakes_in_axes_are_named(axes, message):
    with pytest.raises(RecordingError, match=message):
        parse_mapping(mapped(axes))


def test_velocities_have_the_width_of_the_joint():
    content = mapped({"world": "ned"})
    content["joints"]["root"]["velocity"] = {"column": ["vx", "vy", "vz"]}
    with pytest.raises(RecordingError, match=r"joints.root.axes: expected 6 columns of the velocity beside it, got 3"):
        parse_mapping(content)


def test_without_a_model_other_widths_are_kept_as_they_are(flight, tmp_path):
    content = mapped()
    content["joints"]["root"]["velocity"] = {"column": ["wx", "wy", "wz"]}
    path = write_csv(tmp_path / "flight.csv", as_written(flight))
    (episode,) = import_recordings([path], parse_mapping(content)).trajectories
    assert episode.observations["qpos"].shape[1:] == (7,) and episode.observations["qvel"].shape[1:] == (3,)


def test_a_hinge_has_no_axes():
    joints = {"hip": {"position": "q", "axes": {"world": "ned"}}}
    with pytest.raises(RecordingError, match=r"joints.hip.axes: axes are of ball and free joints"):
        parse_mapping({"dt": 0.1, "joints": joints})


def test_what_is_no_quaternion_is_refused(flight, tmp_path):
    columns = as_written(flight)
    columns["qy"] = columns["qy"] + 3
    with pytest.raises(RecordingError, match=r"columns qw, qx, qy, qz have length 3\.\d+ at .*expected 1"):
        imported(columns, mapped(), tmp_path)


def px4(column):
    """Of PX4's names."""
    names = {"vx": "vehicle_local_position.vx", "vy": "vehicle_local_position.vy", "vz": "vehicle_local_position.vz"}
    names |= {axis: f"vehicle_local_position.{axis}" for axis in "xyz"} | {"t": "time_s"}
    names |= {f"q{axis}": f"vehicle_attitude.q[{i}]" for i, axis in enumerate("wxyz")}
    names |= {f"w{axis}": f"vehicle_angular_velocity.xyz[{i}]" for i, axis in enumerate("xyz")}
    return (names | {"a": "actuator_motors.control[0]", "b": "actuator_motors.control[1]"})[column]


def odometry(column):
    """Of a table of ROS's odometry."""
    names = {axis: f"/odom/pose/pose/position/{axis}" for axis in "xyz"} | {"t": "time_s"}
    names |= {f"q{axis}": f"/odom/pose/pose/orientation/{axis}" for axis in "wxyz"}
    names |= {f"v{axis}": f"/odom/twist/twist/linear/{axis}" for axis in "xyz"}
    names |= {f"w{axis}": f"/odom/twist/twist/angular/{axis}" for axis in "xyz"}
    return (names | {"a": "left_command", "b": "right_command"})[column]


@pytest.mark.parametrize(
    ("named", "written", "axes"),
    [
        (px4, {"world": DOWN, "body": DOWN}, {"world": "ned", "body": "frd"}),
        (odometry, {"linear": "body"}, {"linear": "body"}),
        (str, {}, None),
    ],
)
def test_a_draft_knows_usual_names_of_floating_bodies(named, written, axes, flight, tmp_path):
    columns = as_written(flight, **written)
    if named is px4:
        columns |= {"a": columns["a"] / 8, "b": columns["b"] / 8}
    columns = {named(name): values for name, values in columns.items()}
    (tmp_path / "drone.xml").write_text(DRONE)
    content, text = drafted(write_csv(tmp_path / "flight.csv", columns), tmp_path / "drone.xml")
    assert content["joints"]["root"].get("axes") == axes and yaml.safe_load(text) == content
    if named is str:
        content["actuators"] = {"left": "a", "right": "b"}  # these names tell nothing
    (episode,) = imported(columns, content, tmp_path).trajectories
    _, qpos, qvel, commands = flight
    np.testing.assert_allclose(episode.observations["qvel"], qvel, atol=1e-12)
    np.testing.assert_allclose(episode.observations["qpos"][:, :3], qpos[:, :3], atol=1e-12)
    np.testing.assert_allclose(episode.actions, commands[:-1], rtol=1e-6)


MAVLINK = {**{axis: f"LOCAL_POSITION_NED.{axis}" for axis in ("x", "y", "z", "vx", "vy", "vz")}, "t": "time_s"}
MAVLINK |= {angle: f"ATTITUDE.{angle}" for angle in ("roll", "pitch", "yaw")}
MAVLINK |= {w: f"ATTITUDE.{angle}speed" for w, angle in (("wx", "roll"), ("wy", "pitch"), ("wz", "yaw"))}
CRAZYFLIE = {name: f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw")}
CRAZYFLIE |= {"wx": "gyro.x", "wy": "gyro.y", "wz": "gyro.z", "t": "time_s"}


@pytest.mark.parametrize(
    ("names", "written", "rates", "axes"),
    [
        (MAVLINK, {"world": DOWN, "body": DOWN}, 1.0, {"world": "ned", "body": "frd", "angles": "rad"}),
        (CRAZYFLIE, {}, 180 / np.pi, {"angles": "deg", "rates": "deg/s", "pitch": "reversed"}),
        ({"t": "t"}, {}, 1.0, {"angles": "deg"}),
        ({"t": "t", "wx": "p", "wy": "q", "wz": "r"}, {}, 1.0, {"angles": "rad"}),
    ],
)
def test_a_draft_knows_roll_pitch_and_yaw(names, written, rates, axes, flight, tmp_path):
    pitch = -1 if axes.get("pitch") else 1
    columns = in_angles(as_written(flight, **written), degrees=axes["angles"] == "deg", pitch=pitch)
    columns |= {name: rates * columns[name] for name in ("wx", "wy", "wz")}
    columns = {names.get(name, name): values for name, values in columns.items() if not name.startswith("q")}
    (tmp_path / "drone.xml").write_text(DRONE)
    content, text = drafted(write_csv(tmp_path / "flight.csv", columns), tmp_path / "drone.xml")
    assert content["joints"]["root"]["axes"] == axes
    assert ("BY THEIR SIZE ONLY" in text) == (len(names) < 5)
    content["actuators"] = {"left": "a", "right": "b"}
    (episode,) = imported(columns, content, tmp_path).trajectories
    _, qpos, qvel, _ = flight
    np.testing.assert_allclose(episode.observations["qvel"], qvel, atol=1e-9)
    np.testing.assert_allclose(episode.observations["qpos"][:, :3], qpos[:, :3], atol=1e-9)


def test_two_floating_bodies_are_left_to_the_person(flight, tmp_path):
    columns = as_written(flight)
    columns |= {f"other_{name}": columns[name] for name in sum(NAMES, ())}
    (tmp_path / "drone.xml").write_text(DRONE)
    _, text = drafted(write_csv(tmp_path / "flight.csv", columns), tmp_path / "drone.xml")
    assert "# position: {column: [...]}" in text
