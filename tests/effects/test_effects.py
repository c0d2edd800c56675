"""Effects: each does what it says on a small model, and nothing else; their YAML form is complete."""

import json

import mujoco
import numpy as np
import pytest
import yaml

from idapt_pl.effects import EFFECTS, Domain, effect_from_dict
from idapt_pl.effects.actuators import (
    ActuatorBias,
    ActuatorCurve,
    ActuatorDeadzone,
    ActuatorGain,
    ActuatorKp,
    ActuatorKv,
    ActuatorRotation,
    ActuatorSaturation,
    MotorConstant,
    MotorResistance,
    MotorStrength,
)
from idapt_pl.effects.bodies import BodyCom, BodyInertia, BodyMass, Payload
from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.effects.contacts import ContactFriction, ContactSoftness
from idapt_pl.effects.couplings import SharedMotor
from idapt_pl.effects.end_stops import JointRange
from idapt_pl.effects.joints import (
    JointArmature,
    JointBacklash,
    JointCogging,
    JointDamping,
    JointDrag,
    JointFrictionloss,
    JointSpringref,
    JointStiffness,
    JointStribeck,
)
from idapt_pl.effects.learned import LearnedForce, ResidualNetwork
from idapt_pl.effects.runtime import ForceEffect, SensingEffect
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag, SensorBias, SensorDelay, SensorGain
from idapt_pl.effects.visual import (
    Blur,
    CameraFrame,
    CameraPose,
    Color,
    Light,
    Material,
    Renderer,
    Scenery,
    Texture,
    orbit_axes,
)
from idapt_pl.effects.world import ExternalForce, FluidDrag, GravityDirection, Numerics
from idapt_pl.tasks import make_task

MODEL = """
<mujoco>
  <asset><material name="paint" rgba="0 1 0 1"/></asset>
  <worldbody>
    <camera name="view" pos="0 -3 1"/>
    <light name="lamp" pos="0 0 3"/>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="block" pos="0 0 1"><joint name="slide" type="slide" axis="1 0 0" damping="0.5"/>
      <geom name="box" type="box" size="0.1 0.2 0.3" material="paint"/>
      <geom name="knob" type="sphere" size="0.05" pos="0.1 0 0.3" mass="0.7"/>
      <body name="link" pos="0 0 0.5"><joint name="hinge" axis="0 1 0"/>
        <inertial pos="0 0 0.1" mass="2" diaginertia="0.1 0.2 0.3"/>
        <geom name="rod" type="capsule" size="0.05" fromto="0 0 0 0 0 0.4"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="slide" gear="2"/>
    <dcmotor name="dc" joint="hinge" motorconst="0.05" resistance="2" input="voltage"/>
    <position name="hold" joint="hinge" kp="30"/></actuator>
</mujoco>"""

EXAMPLES = [
    BodyMass("block", 7.0),
    JointDamping("hinge", 1.5),
    JointFrictionloss("slide", 0.3),
    JointArmature("*", 0.02),
    ActuatorGain("push", 0.8),
    ContactFriction("floor", 0.1),
    GravityDirection("world", tilt_x=0.1, tilt_y=-0.2),
    Numerics("world", timestep=0.001, integrator="implicitfast"),
    ActuatorKp("hold", 0.7),
    ActuatorKv("push", 0.3),
    BodyCom("link", x=0.01, z=-0.02),
    BodyInertia("link", mass=1.1, rotation=1.2, x=0.01, xy=0.1),
    MotorConstant("dc", 1.2),
    MotorResistance("dc", 1.2),
    MotorStrength("hold", 0.8),
    ActuatorRotation("push hold", 0.3),
    ContactSoftness("*", 0.05),
    FluidDrag("world", density=1.2, viscosity=0.1),
    JointBacklash("hinge", 0.05),
    JointRange("hinge", upper=0.5),
    JointDrag("hinge", 0.4),
    JointSpringref("hinge", 0.2),
    JointStiffness("slide", 3.0),
    Payload("link", 0.5, z=0.4),
    ActuatorBias("push", 0.1),
    ActuatorDelay("push", 0.005),
    ActuatorLag("push", 0.03),
    ActuatorSaturation("push", 0.5),
    ActuatorSaturation("hold", force=0.5),
    ActuatorCurve("push", 0.5, full=2.0),
    ActuatorDeadzone("push", 0.05),
    ExternalForce("block", x=1.0),
    JointCogging("hinge", 0.1),
    LearnedForce("hinge", "-a*tanh(v/b)", a=0.1, b=0.2),
    ResidualNetwork("hinge", "q", (1.0,), (1.0, 0.0, 0.5, 0.1), 2.0),
    JointStribeck("slide", 0.1, 0.2),
    SensorBias("hinge", 0.1),
    SharedMotor("slide hinge", frictionloss=0.1, ratio=-0.5),
    SensorDelay("*", 0.02),
    SensorGain("hinge", 1.1),
    CameraPose("view", azimuth=90, elevation=-45, distance=2, lookat=(0, 0, 1), fovy=30),
    Light("headlight", diffuse=(0.1, 0.2, 0.3), ambient=(0, 0, 0.5)),
    Color("box", (0.1, 0.2, 0.3, 1)),
    CameraFrame("view", (0, -2, 1), xyaxes=(1, 0, 0, 0, 0, 1)),
    Blur("world", 0.01),
    Texture("sky", flat=(0.2, 0.3, 0.4), fade_to=(0, 0, 0)),
    Material("floor", dm_control="grid"),
    Scenery("world", "interior", position=(1, 2, 0)),
    Renderer("world", "filament"),
    ActuatorRotation("push hold", 0.5),
]


def compiled(*effects):
    return Domain("test", lambda: mujoco.MjSpec.from_string(MODEL), effects).spec().compile()


@pytest.fixture(scope="module")
def nominal():
    return compiled()


def changed(a, b):
    """Names of the model arrays that differ."""
    pairs = {k: (getattr(a, k), getattr(b, k)) for k in dir(a) if isinstance(getattr(a, k, None), np.ndarray)}
    return {k for k, (x, y) in pairs.items() if x.shape != y.shape or not np.array_equal(x, y)}


def test_every_effect_has_an_example_here():
    assert {e.name for e in EXAMPLES} == set(EFFECTS)


@pytest.mark.parametrize("effect", EXAMPLES, ids=lambda e: e.name)
def test_effect_survives_yaml_and_json(effect):
    assert effect_from_dict(yaml.safe_load(yaml.safe_dump(effect.to_dict()))) == effect
    assert effect_from_dict(json.loads(json.dumps(effect.to_dict()))) == effect


BEYOND_MJCF = ForceEffect | SensingEffect | ActuatorCurve | ActuatorDeadzone | ActuatorRotation | SensorDelay


@pytest.mark.parametrize("effect", EXAMPLES, ids=lambda e: e.name)
def test_effect_changes_the_model_the_same_way_from_its_dictionary(effect, nominal):
    once, again = compiled(effect), compiled(effect_from_dict(effect.to_dict()))
    assert changed(once, again) == set()
    headlight = {k: getattr(once.vis.headlight, k).tolist() for k in ("diffuse", "ambient")}
    nominal_headlight = {k: getattr(nominal.vis.headlight, k).tolist() for k in ("diffuse", "ambient")}
    names = ("timestep", "integrator", "density", "viscosity")
    same_options = all(getattr(once.opt, n) == getattr(nominal.opt, n) for n in names)
    same_options &= once.opt.gravity.tolist() == nominal.opt.gravity.tolist()
    differs = bool(changed(nominal, once)) or headlight != nominal_headlight or not same_options
    beyond_mjcf = isinstance(effect, BEYOND_MJCF)
    beyond_mjcf = beyond_mjcf and not effect.constrains
    assert differs != beyond_mjcf, "an effect edits the MJCF, or is one that MJCF has no words for"


DERIVED = {
    "body_subtreemass",
    "body_invweight0",
    "dof_invweight0",
    "dof_M0",
    "actuator_acc0",
    "actuator_length0",
}
MASS = DERIVED | {"body_mass", "body_inertia"}


@pytest.mark.parametrize("body", ["block", "link"])
def test_body_mass_scales_mass_and_inertia_together_and_leaves_the_centre_of_mass(body, nominal):
    model = compiled(BodyMass(body, 7.0))
    before, after = nominal.body(body), model.body(body)
    assert after.mass[0] == pytest.approx(7.0)
    np.testing.assert_allclose(after.inertia, before.inertia * 7.0 / before.mass[0], rtol=1e-9)
    np.testing.assert_allclose(after.ipos, before.ipos, atol=1e-12)
    np.testing.assert_allclose(after.iquat, before.iquat, atol=1e-9)
    others = [b for b in range(nominal.nbody) if b != before.id]
    np.testing.assert_array_equal(model.body_mass[others], nominal.body_mass[others])


def test_body_mass_for_all_bodies_sets_each_of_them():
    assert compiled(BodyMass("*", 7.0)).body_mass.tolist() == pytest.approx([0.0, 7.0, 7.0])


def test_body_mass_for_all_bodies_reaches_those_without_a_name():
    xml = "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
    model = Domain("test", lambda: mujoco.MjSpec.from_string(xml), (BodyMass("*", 3.0),)).spec().compile()
    assert model.body_mass[1] == pytest.approx(3.0)


def test_body_mass_of_a_massless_body_is_an_error():
    with pytest.raises(ValueError, match=r"world.*no mass"):
        compiled(BodyMass("world", 1.0))


@pytest.mark.parametrize(
    ("effect", "field", "values"),
    [
        (JointDamping("hinge", 1.5), "dof_damping", [0.5, 1.5]),
        (JointDamping("*", 1.5), "dof_damping", [1.5, 1.5]),
        (JointFrictionloss("slide", 0.3), "dof_frictionloss", [0.3, 0.0]),
        (JointArmature("hinge", 0.02), "dof_armature", [0.0, 0.02]),
    ],
    ids=lambda x: getattr(x, "name", None),
)
def test_joint_effect_sets_its_field_where_asked(effect, field, values, nominal):
    model = compiled(effect)
    np.testing.assert_allclose(getattr(model, field), values)
    assert changed(nominal, model) <= {field} | DERIVED


@pytest.mark.parametrize(("target", "rest"), [("hinge", [0.0, 0.2]), ("slide", [0.2, 0.0])])
@pytest.mark.parametrize("angle", ["degree", "radian"])
def test_a_rest_position_is_in_radians_and_metres_whatever_the_model_writes(target, rest, angle):
    spec = mujoco.MjSpec.from_string(MODEL.replace("<mujoco>", f"<mujoco><compiler angle='{angle}'/>"))
    JointSpringref(target, 0.2).apply(spec)
    np.testing.assert_allclose(spec.compile().qpos_spring, rest)


def test_a_lag_in_front_of_a_dc_motor_is_not_written_into_the_model(nominal):
    assert changed(nominal, compiled(ActuatorLag("dc", 0.03))) == set()


def test_actuator_gain_scales_what_a_command_does(nominal):
    model = compiled(ActuatorGain("push", 0.8))

    def force(m):
        data = mujoco.MjData(m)
        data.ctrl[0] = 3.0
        mujoco.mj_forward(m, data)
        return data.qfrc_actuator[0]

    assert force(nominal) == pytest.approx(6.0) and force(model) == pytest.approx(0.8 * 6.0)
    assert changed(nominal, model) <= {"actuator_gainprm"} | DERIVED


@pytest.mark.parametrize(
    ("effect", "per_volt", "per_speed"),
    [(ActuatorGain("dc", 0.5), 0.5, 0.5), (MotorConstant("dc", 2.0), 2.0, 4.0)],
    ids=lambda x: getattr(x, "name", None),
)
def test_effects_on_a_dc_motor(effect, per_volt, per_speed, nominal):
    """Torque = K / R (u - K v): the gain divides R, the constant is in front of the voltage once and of v twice."""

    def torques(m):
        found = []
        for u, v in ((1.0, 0.0), (0.0, 1.0)):
            data = mujoco.MjData(m)
            data.ctrl[m.actuator("dc").id], data.joint("hinge").qvel = u, v
            mujoco.mj_forward(m, data)
            found.append(data.actuator("dc").force[0])
        return np.array(found)

    np.testing.assert_allclose(torques(compiled(effect)) / torques(nominal), [per_volt, per_speed])


def test_body_inertia_stays_that_of_a_body(nominal):
    """Ten numbers, and whatever they are the inertia is positive and its trace is what ``rotation`` says."""
    model = compiled(BodyInertia("link", mass=2.0, rotation=1.5, x=0.01, xy=0.05, xx=0.03))
    before, after = nominal.body("link"), model.body("link")
    assert after.mass[0] == pytest.approx(2 * before.mass[0])
    assert (after.inertia > 0).all() and after.inertia.max() < after.inertia.sum() / 2
    np.testing.assert_allclose(after.ipos - before.ipos, [0.01, 0, 0], atol=1e-9)
    assert np.prod(after.inertia) == pytest.approx(1.5**3 * np.prod(before.inertia)), "exp(E) of a traceless E"
    assert np.abs(after.iquat - before.iquat).max() > 1e-3, "its axes turn"


def test_contact_friction_sets_sliding_friction_alone(nominal):
    model = compiled(ContactFriction("floor", 0.1))
    assert model.geom("floor").friction.tolist() == [0.1, *nominal.geom("floor").friction[1:].tolist()]
    assert changed(nominal, model) == {"geom_friction"}


def test_gravity_direction_turns_gravity_and_keeps_its_strength(nominal):
    g = np.linalg.norm(nominal.opt.gravity)
    np.testing.assert_allclose(compiled(GravityDirection("world", 0.0, 0.0)).opt.gravity, [0, 0, -g], atol=1e-12)
    tilted = compiled(GravityDirection("world", 0.3, -0.2)).opt.gravity
    assert np.linalg.norm(tilted) == pytest.approx(g)
    about_x = compiled(GravityDirection("world", 0.3, 0.0)).opt.gravity
    np.testing.assert_allclose(about_x, [0, g * np.sin(0.3), -g * np.cos(0.3)], atol=1e-12)


def test_numerics_sets_time_step_and_integrator():
    option = compiled(Numerics("world", 0.001, "implicitfast")).opt
    assert option.timestep == 0.001 and option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def test_numerics_lists_the_integrators():
    with pytest.raises(ValueError, match=r"Euler, RK4, implicit.*'Verlet'"):
        compiled(Numerics("world", 0.001, "Verlet"))


def test_camera_pose_looks_at_its_point_from_its_distance(nominal):
    model = compiled(CameraPose("view", azimuth=30, elevation=-40, distance=2, lookat=(0.1, 0.2, 0.3), fovy=30))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    forward = -data.cam_xmat[0].reshape(3, 3)[:, 2]  # a camera looks along its -z
    np.testing.assert_allclose(data.cam_xpos[0] + 2 * forward, [0.1, 0.2, 0.3], atol=1e-9)
    np.testing.assert_allclose(forward, orbit_axes(30, -40)[0], atol=1e-9)
    assert forward[2] < 0 and model.cam_fovy[0] == 30
    assert all(name.startswith("cam_") for name in changed(nominal, model))


def test_light_on_the_headlight_sets_only_given_channels(nominal):
    model = compiled(Light("headlight", diffuse=(0.1, 0.2, 0.3)))
    np.testing.assert_allclose(model.vis.headlight.diffuse, [0.1, 0.2, 0.3], rtol=1e-6)
    np.testing.assert_array_equal(model.vis.headlight.ambient, nominal.vis.headlight.ambient)


def test_light_edits_a_lamp_that_is_there_and_adds_one_that_is_not():
    edited = compiled(Light("lamp", diffuse=(0.1, 0.2, 0.3), position=(1, 2, 3)))
    assert edited.nlight == 1 and edited.light_pos[0].tolist() == [1, 2, 3]
    added = compiled(Light("another", diffuse=(0.1, 0.2, 0.3), position=(1, 2, 3)))
    assert added.nlight == 2 and added.light("another").dir.tolist() == [0, 0, -1]
    np.testing.assert_allclose(added.light("another").diffuse, [0.1, 0.2, 0.3], rtol=1e-6)


def test_color_shows_even_on_a_geom_that_had_a_material(nominal):
    model = compiled(Color("box", (0.1, 0.2, 0.3, 1)))
    np.testing.assert_allclose(model.geom("box").rgba, [0.1, 0.2, 0.3, 1], rtol=1e-6)
    assert model.geom("box").matid[0] == -1
    assert changed(nominal, model) <= {"geom_rgba", "geom_matid"}


def test_rotation_turns_the_first_command_towards_its_partner_and_leaves_the_others():
    turn = ActuatorRotation("push hold", np.pi / 2)
    domain = Domain("test", lambda: mujoco.MjSpec.from_string(MODEL), (turn, ActuatorDeadzone("hold", 0.25)))
    model = domain.compile()
    push, hold = model.actuator("push").id, model.actuator("hold").id
    actions = np.full((2, model.nu), 0.5)
    actions[:, [push, hold]] = [[1, 0], [0, 1]]
    commands, expected = domain.command(model, actions), actions.copy()
    expected[:, [push, hold]] = [[0, 0.75], [-1, 0]]
    np.testing.assert_allclose(commands, expected, atol=1e-12)
    np.testing.assert_array_equal(actions[:, [push, hold]], [[1, 0], [0, 1]])


def test_camera_frame_is_the_same_from_axes_and_from_a_quaternion(nominal):
    axes = compiled(CameraFrame("view", (0, -2, 1), xyaxes=(0, 1, 0, 0, 0, 1)))
    quat = compiled(CameraFrame("view", (0, -2, 1), quat=tuple(axes.camera("view").quat)))
    np.testing.assert_allclose(quat.camera("view").quat, axes.camera("view").quat, atol=1e-12)
    with pytest.raises(ValueError, match="give either xyaxes or quat"):
        compiled(CameraFrame("view", (0, -2, 1)))


def test_nothing_in_a_room_can_be_touched_and_its_robot_stands_where_asked(nominal):
    model = compiled(Scenery("world", "interior", position=(1, 2, 0)))
    assert model.ngeom > nominal.ngeom + 20 and model.nv == nominal.nv
    for i in range(model.ngeom):
        if model.geom(i).name.startswith("interior/"):
            assert model.geom_contype[i] == model.geom_conaffinity[i] == 0
    np.testing.assert_allclose(model.geom("interior/boards").pos[:2], (1, 2))


def test_material_that_dm_control_lacks_is_an_error_that_lists_those_it_has():
    with pytest.raises(ValueError, match=r"no material 'gird'; there are: grid, self"):
        compiled(Material("floor", dm_control="gird"))


def test_texture_paints_the_sky_once_even_if_applied_twice():
    model = compiled(Texture("sky", dm_control="skybox.xml"), Texture("sky", flat=(0.2, 0.4, 0.6)))
    assert model.ntex == 1 and model.tex_type[0] == mujoco.mjtTexture.mjTEXTURE_SKYBOX
    assert np.unique(model.tex_data.reshape(-1, 3), axis=0).tolist() == [[51, 102, 153]]


# --- errors name what is known ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"effect": "body_masss", "target": "block"}, "unknown effect 'body_masss'.*body_mass, "),
        ({"effect": "body_mass", "target": "block", "parameters": None}, r"mass is missing; got \[\]"),
        ({"effect": "learned_force", "target": "block", "parameters": {"a": 1}}, r"expression is missing; got \['a'\]"),
        (
            {"effect": "body_mass", "target": "block", "parameters": {"kg": 3}},
            r"among \['mass'\], got \['kg'\]",
        ),
        ({"effect": "body_mass", "target": "block", "params": {"mass": 3}}, "unknown key.*params"),
        ({"target": "block"}, "keys effect, target, parameters"),
        ("body_mass", "keys effect, target, parameters"),
        (
            {"effect": "body_mass", "target": "block", "parameters": {"mass": "heavy"}},
            "must be numeric, got 'heavy'",
        ),
        (
            {"effect": "body_mass", "target": "block", "parameters": {"mass": -1.0}},
            r"mass = -1.0 kg is outside \[",
        ),
        (
            {"effect": "body_mass", "target": "block", "parameters": {"mass": float("nan")}},
            "mass = nan kg is outside",
        ),
    ],
)
def test_wrong_entries_are_refused_with_what_is_known(entry, message):
    with pytest.raises(ValueError, match=message):
        effect_from_dict(entry)


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (BodyMass("blok", 1.0), "named 'blok'; it has: .*block, link"),
        (JointDamping("hing", 1.0), "no joint named 'hing'; it has: slide, hinge"),
        (ActuatorGain("pull", 1.0), "no actuator named 'pull'; it has: push, dc, hold"),
        (Color("bix", (0, 0, 0, 1)), "no geom named 'bix'; it has: floor, box, knob, rod"),
        (CameraPose("eye", 0, 0, 1, (0, 0, 0)), "no camera named 'eye'; it has: view"),
        (Texture("floor", flat=(0, 0, 0)), "'sky', got 'floor'"),
    ],
    ids=lambda x: getattr(x, "name", None),
)
def test_a_target_that_does_not_exist_is_an_error_that_lists_those_that_do(effect, message):
    with pytest.raises(ValueError, match=message):
        compiled(effect)


def test_later_effects_win_and_with_effects_leaves_the_original_alone():
    base = Domain("test", lambda: mujoco.MjSpec.from_string(MODEL), (BodyMass("link", 5.0),))
    heavier = base.with_effects(BodyMass("link", 9.0))
    assert base.spec().compile().body("link").mass[0] == pytest.approx(5.0)
    assert heavier.spec().compile().body("link").mass[0] == pytest.approx(9.0)


@pytest.mark.parametrize(("speed", "moves"), [(0.0, False), (1.0, True)])
def test_stribeck_friction_holds_what_rests_and_lets_slide_what_moves(speed, moves):
    """Pushed with a force between the two levels: a block at rest stays, one that slides gets faster."""
    effect, push = JointStribeck("slide", coulomb=2.0, static=6.0, speed=0.05), 4.0
    spec = Domain("test", lambda: mujoco.MjSpec.from_string(MODEL), (JointDamping("slide", 0.0),)).spec()
    effect.constrain(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[0] = speed
    for _ in range(200):
        law = effect.force(data.qpos[:1], data.qvel[:1], np.zeros(1))
        data.qfrc_applied[0] = push + law[0]
        mujoco.mj_step(model, data)
    gained = data.qvel[0] - speed
    expected = (push - effect.coulomb) / model.body_subtreemass[1] * data.time
    assert gained == pytest.approx(expected, rel=0.1) if moves else abs(data.qvel[0]) < 0.02


@pytest.mark.parametrize("coulomb", [0.0, 3.0])
def test_stribeck_friction_without_a_fall_is_dry_friction(coulomb):
    v = np.linspace(-1, 1, 7)
    assert not JointStribeck("slide", coulomb, coulomb, 0.1).force(v, v, v).any()


def test_two_plays_in_one_joint_add_up():
    twice = compiled(JointBacklash("hinge", 0.05), JointBacklash("*", 0.15))
    assert twice.joint("hinge play").range == pytest.approx([-0.1, 0.1])
    assert twice.njnt == compiled(JointBacklash("*", 0.2)).njnt


def test_a_link_with_backlash_turns_freely_by_the_width_and_no_further():
    model = compiled(JointBacklash("hinge", 0.2), JointFrictionloss("hinge", 50.0))
    data, behind = mujoco.MjData(model), model.joint("hinge play")
    reached = []
    for torque in (0.05, -0.05):
        mujoco.mj_resetData(model, data)
        data.qfrc_applied[behind.dofadr[0]] = torque  # on the link; dry friction holds the motor
        for _ in range(2000):
            mujoco.mj_step(model, data)
        assert data.joint("hinge").qpos[0] == pytest.approx(0.0, abs=0.02), "dry friction creeps a little"
        reached.append(data.joint("hinge play").qpos[0])
    assert reached == pytest.approx([0.1, -0.1], abs=0.01)


def test_a_force_limit_holds_whatever_the_set_point():
    model = compiled(ActuatorSaturation("hold", force=0.5))
    data = mujoco.MjData(model)
    data.ctrl[:] = 100.0
    mujoco.mj_forward(model, data)
    assert abs(data.actuator("hold").force[0]) == pytest.approx(0.5)


# --- joints that actuators act on -----------------------------------------------------------------------


def test_actuated_joints_are_those_of_the_motors_and_not_the_base():
    task = make_task("half_cheetah")
    domain = task.domain("source").with_effects(JointArmature("actuated", 0.3))
    before, after = task.domain("source").compile(), domain.compile()
    changed = {before.joint(i).name for i in range(before.njnt) if before.joint(i).armature != after.joint(i).armature}
    assert changed == {"bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot"}
    assert after.joint("fshin").armature == pytest.approx(0.3)


def test_a_model_whose_actuators_act_on_no_joint_says_so():
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><body><joint name='a'/><geom size='1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(ValueError, match="no actuator of the model acts on a joint; its joints: a"):
        JointArmature("actuated", 0.3).apply(spec)


def test_a_joint_that_is_called_actuated_is_meant_by_its_name():
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><body><joint name='actuated'/><joint name='b' axis='1 0 0'/><geom size='1'/></body>"
        "</worldbody><actuator><motor joint='b'/></actuator></mujoco>"
    )
    JointArmature("actuated", 0.3).apply(spec)
    assert [j.armature for j in spec.joints] == [0.3, 0.0]


def test_masses_are_told_apart_where_static_bodies_are_fused_when_compiled():
    """As MuJoCo does with URDF: the flange has no joint, and the compiled model no body of its name."""
    xml = """<mujoco><compiler fusestatic="true"/><worldbody><body name="arm"><joint/><geom size="0.1" mass="2"/>
      <body name="flange" pos="1 0 0"><geom size="0.1" mass="1"/></body></body></worldbody></mujoco>"""
    masses = {}
    for name, effects in {"as it is": (), "heavier": (BodyMass("arm", 5.0), BodyMass("flange", 3.0))}.items():
        masses[name] = Domain("source", lambda: mujoco.MjSpec.from_string(xml), effects).compile().body_mass
    assert [len(m) for m in masses.values()] == [2, 2] and masses["as it is"][1] == pytest.approx(3.0)
    assert masses["heavier"][1] == pytest.approx(8.0)


def test_a_motors_resistance_and_loop_are_its_own(nominal):
    """gainprm of a dcmotor: resistance, torque constant, ..., gain of its position loop."""
    assert compiled(MotorResistance("dc", 1.5)).actuator("dc").gainprm[:2].tolist() == [3.0, 0.05]
    looped = MODEL.replace('input="voltage"', 'input="pos" controller="20 0 0 0 0 12"')
    spec = mujoco.MjSpec.from_string(looped)
    ActuatorKp("*", 0.5).apply(spec)
    model = spec.compile()
    assert model.actuator("dc").gainprm[[0, 1, 4]].tolist() == [2.0, 0.05, 10.0]
    assert model.actuator("hold").gainprm[0] == 15.0


def test_a_weak_motor_gives_less_of_all_that_its_servo_asks_for(nominal):
    """Force = 0.75 (kp (u - q) - kv v), whatever it pulls at; motors without feedback are left to their gains."""
    spec = mujoco.MjSpec.from_string(MODEL.replace('kp="30"', 'kp="30" kv="2"'))
    MotorStrength("*", 0.75).apply(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[:], data.qpos[:], data.qvel[:] = (0.4, 0.0, 0.3), (0.1, 0.2), (0.5, -0.7)
    mujoco.mj_forward(model, data)
    assert data.actuator("hold").force[0] == pytest.approx(0.75 * (30 * (0.3 - 0.2) - 2 * -0.7))
    assert data.actuator("push").force[0] == pytest.approx(0.4)
    named = [c.target for c in MotorStrength.candidates(model, None)]
    assert named == ["hold"] and not MotorStrength.candidates(nominal, None)


def test_a_motor_that_was_never_commanded_has_no_curve(nominal):
    nu, nv = np.ones(nominal.nu), np.ones(nominal.nv)
    for commands, found in ((nu, ["push"]), (1e-9 * nu, [])):
        typical = TypicalSizes(0.02, nv, nv, nv, nv, commands, nu, 0.2)
        assert [c.target for c in ActuatorCurve.candidates(nominal, typical)] == found


def test_what_mjcf_cannot_say_of_a_dcmotor_is_not_written_into_its_other_numbers(nominal):
    for effect in (ActuatorBias("*", 0.1), ActuatorKv("*", 0.3)):
        after = compiled(effect).actuator("dc")
        assert after.biasprm.tolist() == nominal.actuator("dc").biasprm.tolist()


def test_commands_of_two_hinges_are_not_turned():
    """What crosses their wires is a deployment fault; another angle is nothing that a machine can do."""
    joints = ('type="hinge" axis="0 1 0"', 'type="hinge" axis="0 1 0"', 'type="slide"')
    bodies = "".join(
        f'<body name="b{i}"><joint name="j{i}" {how}/><geom size="0.1"/></body>' for i, how in enumerate(joints)
    )
    motors = "".join(f'<motor name="m{i}" joint="j{i}"/>' for i in range(3))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{bodies}<site name="hand"/></worldbody>'
        f'<actuator>{motors}<motor name="m3" site="hand"/></actuator></mujoco>'
    )
    every = TypicalSizes(0.01, *(np.ones(3) for _ in range(4)), np.ones(4), np.ones(4), 0.2)
    assert [c.target for c in ActuatorRotation.candidates(model, every)] == ["m1 m2", "m2 m3"]
