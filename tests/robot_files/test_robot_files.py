"""URDF as a model for a diagnosis: what is kept, what is lost and said, and actuators in plain words."""

import mujoco
import numpy as np
import pytest

from idapt_pl.robot_files.actuators import add_actuators, parse_actuators
from idapt_pl.robot_files.read import is_urdf, read_robot

BOX = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
MASS = '<inertial><mass value="{m}"/><inertia ixx="{x}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>'
GOOD = MASS.format(m=1, x=0.01, i=0.01)
URDF = """<robot name="arm"><link name="base"/><link name="upper">{upper}</link><link name="lower">{lower}</link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="5" velocity="3"/><dynamics damping="0.3" friction="0.2"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -0.3"/>
  <axis xyz="0 1 0"/>{joint}</joint>{more}</robot>"""


@pytest.fixture
def urdf(tmp_path):
    """Writes a URDF with these parts."""

    def write(upper=GOOD, lower=GOOD, joint="", more="", name="arm.urdf"):
        path = tmp_path / name
        path.write_text(URDF.format(upper=upper, lower=lower, joint=joint, more=more))
        return path

    return write


def said(robot, *words):
    return any(all(w in note for w in words) for note in robot.notes)


def test_what_a_urdf_says_is_in_the_model(urdf):
    robot = read_robot(urdf())
    model = robot.spec.compile()
    assert [model.joint(j).name for j in range(2)] == ["shoulder", "elbow"]
    np.testing.assert_allclose(np.ravel(model.dof_damping)[:1], 0.3)
    np.testing.assert_allclose(model.dof_frictionloss, [0.2, 0])
    np.testing.assert_allclose(model.jnt_range[0], [-1, 1])
    np.testing.assert_allclose(model.jnt_actfrcrange[0], [-5, 5])
    np.testing.assert_allclose(model.body("lower").pos, [0, 0, -0.3])
    assert said(robot, "no damping given for elbow") and said(robot, "no friction given for elbow")
    assert said(robot, "velocity limits are dropped", "shoulder") and said(robot, "base", "fixed to the world")
    assert not said(robot, "shoulder: 0"), "its damping is given"


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"lower": ""}, ("no mass and no shape for lower",)),
        ({"lower": BOX}, ("no mass given for lower", "1000 kg/m³")),
        ({"lower": MASS.format(m=0, x=0, i=0)}, ("no mass and no shape for lower",)),
        ({"lower": MASS.format(m=1, x=0, i=0)}, ("no inertia given for lower",)),
        ({"lower": MASS.format(m=1, x=0.05, i=0.01)}, ("inertia of lower", "A + B < C")),
        ({"joint": '<mimic joint="shoulder" multiplier="-2"/>'}, ("mimic joints", "elbow")),
        ({"joint": "<safety_controller/>"}, ("safety_controller", "elbow")),
        (
            {"more": '<transmission name="t"><joint name="elbow"/><actuator name="m"/></transmission>'},
            ("gears of transmissions are not read", "elbow"),
        ),
        ({"more": '<gazebo reference="upper"/>'}, ("gazebo",)),
    ],
)
def test_what_is_dropped_or_defaulted_is_said_and_the_rest_is_read(urdf, parts, words):
    robot = read_robot(urdf(**parts))
    assert said(robot, *words), robot.notes
    model = robot.spec.compile()
    assert model.njnt == 2 and (model.body_mass[1:] > 0).all() and (model.body_inertia[1:] > 0).all()


def test_a_missing_mesh_is_one_warning_and_no_error(urdf):
    mesh = '<{kind}><geometry><mesh filename="package://arm/meshes/{file}"/></geometry></{kind}>'
    shapes = "".join(mesh.format(kind="collision", file=f) for f in ("a.stl", "b.dae"))
    robot = read_robot(urdf(upper=GOOD + shapes + mesh.format(kind="visual", file="c.dae")))
    told = [n for n in robot.notes if "mesh" in n]
    assert len(told) == 3 and said(robot, "a.stl is not there") and said(robot, "1 visual meshes are not there")


def test_a_mesh_of_a_package_is_found_beside_the_urdf_or_above(urdf, tmp_path):
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    faces = ["f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "a.obj").write_text("\n".join([*(f"v {x} {y} {z}" for x, y, z in corners), *faces]))
    shape = '<collision><geometry><mesh filename="package://arm/meshes/a.obj"/></geometry></collision>'
    robot = read_robot(urdf(upper=GOOD + shape))
    assert robot.spec.compile().nmesh == 1 and not said(robot, "mesh")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot", "cannot be read as URDF"),
        (
            "<robot xmlns:xacro='http://www.ros.org/wiki/xacro'><xacro:include filename='a'/></robot>",
            "this is xacro",
        ),
        ("<robot name='a'><link name='b'/></robot>", "nothing to diagnose"),
        (URDF.format(upper=GOOD, lower=GOOD, joint="", more="").replace('child link="lower"', 'child link="lowe"'),
         "its child link 'lowe' is not there"),
        (URDF.format(upper=MASS.format(m="heavy", x=1, i=1), lower=GOOD, joint="", more=""), "expected a number"),
        (URDF.format(upper=GOOD, lower=GOOD, joint="", more="").replace("continuous", "helical"), "helical|joint type"),
    ],
)  # fmt: skip
def test_a_broken_urdf_is_a_clear_error(tmp_path, text, words):
    path = tmp_path / "broken.urdf"
    path.write_text(text)
    with pytest.raises(ValueError, match=words) as error:
        read_robot(path)
    assert str(path) in str(error.value)


def test_mjcf_is_read_as_ever(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text("<mujoco><worldbody><body><joint/><geom size='0.1'/></body></worldbody></mujoco>")
    assert not is_urdf(path) and read_robot(path).notes == () and len(read_robot(path).spec.joints) == 1


def test_motors_take_torques_and_servos_targets(urdf):
    motor = read_robot(urdf(), parse_actuators("motor")).spec.compile()
    assert motor.nu == 2 and motor.actuator(0).name == "shoulder" and motor.actuator_gainprm[0, 0] == 1
    servo = read_robot(urdf(), parse_actuators("position:kp=30,kv=2")).spec.compile()
    data = mujoco.MjData(servo)
    data.ctrl[:], data.qvel[:] = [0.1, 0.0], [0.0, 0.5]
    mujoco.mj_forward(servo, data)
    np.testing.assert_allclose(data.actuator_force, [30 * 0.1, -2 * 0.5])


def test_a_file_gives_each_joint_its_own_in_the_commands_order(urdf, tmp_path):
    path = tmp_path / "drives.yaml"
    path.write_text("elbow: {type: position, kp: 20}\nshoulder: motor\n")
    robot = read_robot(urdf(), parse_actuators(str(path)))
    assert [a.name for a in robot.spec.actuators] == ["elbow", "shoulder"]
    assert said(robot, "in this order: elbow, shoulder")


def test_a_joint_that_mimics_another_gets_no_actuator(urdf):
    robot = read_robot(urdf(joint='<mimic joint="shoulder"/>'), parse_actuators("motor"))
    assert [a.name for a in robot.spec.actuators] == ["shoulder"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("servo", "write motor"), ("position", "position needs kp"), ("position:kp=x", "must be a number"),
        ("motor:kp=3", "motor has no setting 'kp'; it has: gear"), ("position:kp=-1", "must be 0 or more"),
        ("drives.yaml", "no such file"),
    ],
)  # fmt: skip
def test_actuators_that_cannot_be_read_are_a_clear_error(text, words):
    with pytest.raises(ValueError, match=words):
        parse_actuators(text)


@pytest.mark.parametrize(
    "moments", ["2.4e-8 6.1e-8 1.2e-8 2.8e-8 0.8e-8 3.8e-8", "0.01 0.05 0 0.02 0 0.01", "-1 0 0 1 0 1"]
)
def test_an_inertia_that_no_body_has_is_mended(moments, urdf):
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    inertia = " ".join(f'{n}="{v}"' for n, v in zip(names, moments.split(), strict=True))
    link = f'<inertial><mass value="0.1"/><inertia {inertia}/></inertial>'
    robot = read_robot(urdf(lower=link))
    assert (robot.spec.compile().body_inertia[1:] > 0).all()
    assert said(robot, "lower") and robot.spec.compile().nv == 2


TRANSMISSION = '<transmission name="t"><joint name="elbow"/><actuator name="m"/></transmission>'
CONTROL = '<ros2_control name="r" type="system"><joint name="elbow">{}</joint></ros2_control>'


@pytest.mark.parametrize(
    ("more", "driven"),
    [
        (TRANSMISSION, ["elbow"]), (CONTROL.format('<command_interface name="effort"/>'), ["elbow"]),
        (CONTROL.format('<state_interface name="position"/>'), ["shoulder", "elbow"]), ("", ["shoulder", "elbow"]),
    ],
)  # fmt: skip
def test_a_file_that_names_its_drives_leaves_the_other_joints_passive(more, driven, urdf):
    robot = read_robot(urdf(more=more), parse_actuators("motor"))
    assert [a.target for a in robot.spec.actuators] == driven
    assert said(robot, "names no drive of shoulder") == (driven == ["elbow"])


def test_a_urdf_whose_world_goes_without_saying_is_the_same_robot(urdf):
    hung = '<joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint>'
    plain, drakes = read_robot(urdf()), read_robot(urdf(more=hung))
    assert plain.spec.compile().nv == drakes.spec.compile().nv == 2
    np.testing.assert_allclose(plain.spec.compile().body_mass, drakes.spec.compile().body_mass)
    assert not said(drakes, "fixed to the world") and said(plain, "fixed to the world")


def test_actuators_of_joints_that_are_not_there_and_a_second_set_are_errors(urdf, tmp_path):
    path = tmp_path / "drives.yaml"
    path.write_text("wrist: motor\n")
    with pytest.raises(ValueError, match=r"joint 'wrist' is not there.*joints to drive: shoulder, elbow"):
        read_robot(urdf(), parse_actuators(str(path)))
    spec = read_robot(urdf(), parse_actuators("motor")).spec
    with pytest.raises(ValueError, match="has actuators already"):
        add_actuators(spec, parse_actuators("motor"), "arm.urdf")


def joints(*elements):
    """A URDF of joints in a chain, a0, a1, ..., each with such elements; its path."""
    links = "".join(f'<link name="l{k}">{GOOD}</link>' for k in range(1, len(elements) + 1))
    made = "".join(
        f'<joint name="a{k}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/>{inside}</joint>'
        for k, (kind, inside) in enumerate(elements)
    )
    return f'<robot name="arm"><link name="l0"/>{links}{made}</robot>'


LIMITS = [
    ("revolute", '<limit lower="-1" upper="1" effort="5" velocity="3"/>'),
    ("revolute", '<limit effort="5"/>'),
    ("revolute", '<limit lower="1" upper="-1" effort="5"/>'),
    ("prismatic", '<limit lower="0" upper="0.2"/>'),
    ("prismatic", '<limit lower="0" upper="0.2" effort="0"/>'),
    ("continuous", '<limit effort="2"/>'),
    ("continuous", ""),
]


def test_limits_of_positions_and_efforts_are_in_the_model_or_named_as_not_given(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(joints(*LIMITS))
    robot = read_robot(path)
    assert said(robot, "no position limits given for a1, a2: none"), robot.notes
    assert said(robot, "no effort limits given for a3, a4, a6: none")
    assert said(robot, "velocity limits are dropped", "(a0)")
    model = robot.spec.compile()
    assert model.jnt_limited.tolist() == [1, 0, 0, 1, 1, 0, 0]
    assert model.jnt_actfrclimited.tolist() == [1, 1, 1, 0, 0, 1, 0]
    np.testing.assert_allclose(model.jnt_range[[0, 3]], [[-1, 1], [0, 0.2]])
    np.testing.assert_allclose(model.jnt_actfrcrange[[0, 1, 5]], [[-5, 5], [-5, 5], [-2, 2]])


def test_where_all_limits_are_given_nothing_is_said_of_them(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(
        joints(("revolute", '<limit lower="-1" upper="1" effort="5"/>'), ("continuous", '<limit effort="2"/>'))
    )
    assert not said(read_robot(path), "limits given")


def test_names_of_many_joints_are_cut_short(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(joints(*[("revolute", "")] * 8))
    assert said(read_robot(path), "no effort limits given for a0, a1, a2, a3, a4, a5 and 2 more: none")


@pytest.mark.parametrize("limit", ['<limit lower="x" upper="1"/>', '<limit effort="inf"/>', '<limit effort="1 2"/>'])
def test_a_limit_that_is_no_number_is_a_clear_error(limit, tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(joints(("revolute", limit)))
    with pytest.raises(ValueError, match=r"arm.urdf: .*<limit \w+='.+'>: expected a number"):
        read_robot(path)
