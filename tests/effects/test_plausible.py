"""What is plausible on machines: the table names what there is, and candidates keep to it."""

import dataclasses

import mujoco
import numpy as np
import pytest

from idapt_pl.effects import EFFECTS
from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.effects.plausible import (
    AIR,
    LIQUID,
    MEASURES,
    PLAUSIBLE,
    RARITY,
    Machine,
    plausible_range,
    with_plausible_ends,
)

CART = """
<mujoco>
  <option timestep="0.01" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="cart"><joint name="slide" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.1 0.1 0.1" mass="3" contype="0" conaffinity="0"/>
      <body name="pole"><joint name="hinge" axis="0 1 0"/>
        <geom type="sphere" size="0.01" pos="0 0 -0.5" mass="1" contype="0" conaffinity="0"/></body></body>
  </worldbody>
  <actuator><motor name="push" joint="slide" gear="1"/></actuator>
</mujoco>"""


@pytest.fixture
def machine():
    """A cart of 4 kg in all, on which 10 N act at most, at 2 m/s."""
    two = np.full(2, 2.0)
    typical = TypicalSizes(0.02, np.ones(2), two, two, two, np.ones(1), np.ones(1), 0.2, effort=np.full(2, 10.0))
    return Machine(mujoco.MjModel.from_xml_string(CART), typical)


def candidates(machine, effect, size=None):
    found = [with_plausible_ends(c, machine) for c in EFFECTS[effect].candidates(machine.model, machine.typical)]
    return {c.target: c for c in found if size is None or c.size == size}


def test_the_table_names_parameters_that_there_are():
    for effect, parameter in PLAUSIBLE:
        assert parameter in {f.name for f in dataclasses.fields(EFFECTS[effect])}, (effect, parameter)
    assert set(RARITY) <= set(EFFECTS)
    for entry in (*PLAUSIBLE.values(), *AIR.values(), *LIQUID.values()):
        assert entry.low < entry.high and entry.unit in MEASURES
        assert entry.reason and not entry.reason.endswith(".")


@pytest.mark.parametrize("effect", sorted({effect for effect, _ in PLAUSIBLE}))
def test_what_the_model_has_is_plausible_and_so_is_every_start(machine, effect):
    for c in candidates(machine, effect).values():
        low, high = c.bounds()
        possible = c.possible()
        assert (low <= c.nominal).all() and (high >= c.nominal).all()
        assert (low >= possible[0]).all() and (high <= possible[1]).all()
        assert all((np.array(s) >= low - 1e-9).all() and (np.array(s) <= high + 1e-9).all() for s in c.starts)


@pytest.mark.parametrize(
    ("effect", "target", "size", "believed", "not_believed"),
    [
        ("gravity_direction", "world", 2, (0.1, 0.1), (1.1, 0.0)),
        ("joint_frictionloss", "slide", 1, (5.0,), (40.0,)),
        ("joint_damping", "slide", 1, (3.0,), (60.0,)),
        ("actuator_gain", "push", 1, (0.6,), (0.03,)),
        ("actuator_curve", "push", 1, (0.3,), (0.9,)),
        ("body_mass", "pole", 1, (2.0,), (40.0,)),
        ("body_com", "pole", 3, (0.1, 0.0, -0.3), (2.0, 0.0, 0.0)),
        ("external_force", "cart", 3, (10.0, 0.0, 0.0), (100.0, 0.0, 0.0)),
        ("actuator_delay", "push", 1, (0.02,), (1.0,)),
    ],
)
def test_ranges_are_those_of_machines(machine, effect, target, size, believed, not_believed):
    low, high = candidates(machine, effect, size)[target].bounds()
    assert (low <= believed).all() and (high >= believed).all()
    assert not ((low <= not_believed).all() and (high >= not_believed).all())


@pytest.mark.parametrize("motor", ['site="tip"', 'joint="slide" ctrlrange="0 5" ctrllimited="true"'])
def test_a_propeller_and_a_valve_may_be_curved_as_they_like(machine, motor):
    xml = CART.replace("</actuator>", f'<motor name="other" {motor}/></actuator>')
    xml = xml.replace('<body name="pole"', '<site name="tip"/><body name="pole"', 1)
    typical = dataclasses.replace(
        machine.typical, **{k: np.append(getattr(machine.typical, k), 1.0) for k in ("command", "force")}
    )
    of_other = candidates(Machine(mujoco.MjModel.from_xml_string(xml), typical), "actuator_curve")["other"]
    assert of_other.bounds()[1] == 1.0


def test_a_thick_medium_is_plausible_only_where_the_model_has_one():
    assert plausible_range("fluid_drag", "viscosity", 0.0).high < 1e-3
    thick = plausible_range("fluid_drag", "viscosity", 0.9)
    assert thick.unit == "of the model's" and thick.low * 0.9 < 0.8 < thick.high * 0.9


ARM = """
<mujoco>
  <worldbody>
    <body name="cart"><joint name="slide" type="slide" axis="1 0 0" stiffness="2"/><geom name="box" size="0.1"/>
      <body name="arm" pos="0 0 0.5"><joint name="hinge" axis="0 1 0"/><geom name="rod" size="0.1" pos="0 0 0.2"/>
        <body name="hand" pos="0 0 0.4"><joint name="wrist" axis="0 1 0"/><geom name="palm" size="0.1"/></body>
      </body></body>
    <geom name="floor" type="plane" size="1 1 1"/>
  </worldbody>
  <actuator><motor name="push" joint="slide"/><position name="hold" joint="hinge" kp="30" kv="1"/>
    <motor name="bend" joint="wrist"/>
    <dcmotor name="turn" joint="hinge" motorconst="0.05" resistance="2" input="voltage"/></actuator>
</mujoco>"""


@pytest.fixture
def arm():
    """With every kind of element, links of half a metre, 6 N·m of usual force."""
    two, six = np.full(3, 2.0), np.full(4, 6.0)
    typical = TypicalSizes(0.02, two, two, two, 3 * two, six, six, 0.2, effort=5 * two, stops=np.outer(two, [-1, 1]))
    return Machine(mujoco.MjModel.from_xml_string(ARM), typical)


@pytest.mark.parametrize("kind", [e for e in EFFECTS.values() if e.searched and e.__module__.startswith("idapt_pl.")])
def test_every_parameter_that_is_searched_has_a_range(arm, kind):
    found = kind.candidates(arm.model, arm.typical)
    assert found
    for c in found:
        for name, nominal in zip(c.names, c.nominal, strict=True):
            entry = plausible_range(kind.name, name, nominal)
            assert entry is not None, f"{kind.name}: {name}"
            assert np.isfinite(MEASURES[entry.unit](arm, c, 0)), f"{kind.name}: {name}: no size to compare with"


@pytest.mark.parametrize(
    ("effect", "target", "parameter", "expected"),
    [
        ("payload", "arm", "x", (-0.75, 0.75)),
        ("joint_stribeck", "hinge", "speed", (0.04, 6.0)),
        ("joint_cogging", "hinge", "periods", (np.pi / 2, 25 * np.pi)),
        ("body_inertia", "arm", "xy", (-1.6, 1.6)),
        ("actuator_saturation", "hold", "force", (0.018, 1e6)),
        ("actuator_rotation", "push hold", "angle", (-np.pi, np.pi)),
        ("shared_motor", "hinge wrist", "frictionloss", (0.0, 15.0)),
    ],
)
def test_places_speeds_and_forces_are_measured_by_the_machine(arm, effect, target, parameter, expected):
    (c,) = [c for c in candidates(arm, effect).values() if c.target == target and parameter in c.names]
    low, high = (b[c.names.index(parameter)] for b in c.bounds())
    assert (low, high) == pytest.approx(expected)


def test_a_joint_that_never_moves_keeps_the_bounds_of_its_effects(arm):
    still = dataclasses.replace(arm, typical=dataclasses.replace(arm.typical, speed=np.array([2.0, 1e-9, 2.0])))
    for kind in (EFFECTS["joint_stribeck"], EFFECTS["joint_drag"], EFFECTS["joint_damping"]):
        for c in kind.candidates(still.model, still.typical):
            low, high = with_plausible_ends(c, still).bounds()
            assert (low <= high).all() and (low >= c.bounds()[0]).all() and (high <= c.bounds()[1]).all()


def test_effects_that_are_not_in_the_table_may_be_anything():
    assert plausible_range("somebody_elses", "strength", 0.0) is None


def test_what_the_model_has_of_drag_is_where_a_search_begins(machine):
    xml = CART.replace('<joint name="hinge"', '<joint name="hinge" damping="1 2 3"')
    spec = mujoco.MjSpec.from_string(xml)
    hinge = candidates(Machine(spec.compile(), machine.typical), "joint_drag")["hinge"]
    assert hinge.nominal == (2.0,)
    hinge.effect(hinge.nominal).apply(spec)
    assert spec.compile().dof_dampingpoly[1].tolist() == [2.0, 3.0]
