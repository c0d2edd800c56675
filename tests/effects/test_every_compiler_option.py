"""Every effect beside every option of the compiler: what it changes is what it changes without them."""

import mujoco
import numpy as np
import pytest

from idapt_pl.diagnosis.candidates.listing import all_candidates
from idapt_pl.effects.base import EFFECTS
from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.prediction.model import read_model

ROBOT = """<mujoco><compiler {}/>
  <default><geom density="{}"/></default>
  <option timestep="0.002" density="1.2" viscosity="0.01"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="rail"><geom name="beam" type="box" size="1 0.02 0.02" contype="0" conaffinity="0"/>
      <body name="cart" pos="0 0 1"><joint name="slide" type="slide" axis="1 0 0" stiffness="3" damping="0.5"/>
        <geom name="box" type="box" size="0.1 0.2 0.3"/>
        <body name="arm" pos="0 0 0.5"><joint name="hinge" axis="0 1 0" stiffness="2" armature="0.01"/>
          <inertial pos="0 0 0.1" mass="2" diaginertia="0.1 0.2 0.25"/>
          <geom name="rod" type="capsule" size="0.05" fromto="0 0 0 0 0 0.4"/>
          <geom name="shell" type="capsule" size="0.06" fromto="0 0 0 0 0 0.4" group="2" contype="0" conaffinity="0"
            mass="0.5"/>
          <body name="hand" pos="0 0 0.4"><joint name="wrist" axis="0 1 0" stiffness="2"/>
            <geom name="palm" type="sphere" size="0.05"/>
            <geom name="glove" type="sphere" size="0.06" group="2" contype="0" conaffinity="0" mass="0.1"/>
            <body name="tool" pos="0.05 0 0.1"><geom name="tip" type="sphere" size="0.03" mass="0.2"/></body></body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="slide" gear="2"/>
    <position name="hold" joint="hinge" kp="30" kv="0.5"/>
    <dcmotor name="turn" joint="wrist" motorconst="0.05" resistance="2" input="voltage"/></actuator>
</mujoco>"""
"""Masses given, of geoms, of geoms that are only seen, and of parts that are welded on."""

OPTIONS = ('settotalmass="30"', 'boundmass="2"', 'boundinertia="0.5"', 'balanceinertia="true"',
           'inertiafromgeom="true"', 'inertiagrouprange="0 1"', 'fusestatic="true"', 'discardvisual="true"',
           'fusestatic="true" discardvisual="true" settotalmass="9" boundmass="0.1" boundinertia="0.01"')  # fmt: skip
CASES = [(option, 1000) for option in OPTIONS] + [("", 300)]
SEEN = ("beam", "shell", "glove")
"""Geoms that touch nothing, and may be discarded."""


def read(tmp_path, option, density):
    """The model as a diagnosis reads it."""
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT.format(option, density))
    return read_model(path)


def raw(option, density):
    """The model as MuJoCo compiles it."""
    return mujoco.MjSpec.from_string(ROBOT.format(option, density))


def written_out(option, density):
    """The same robot with the masses that the option leads to given body by body, and without it."""
    model = raw(option, density).compile()
    spec = raw('fusestatic="true"' if "fusestatic" in option else "", density)
    spec.compile()
    spec.compiler.fusestatic = False
    for body in spec.bodies[1:]:
        own = model.body(body.name)
        body.explicitinertial, body.mass = True, own.mass[0]
        body.ipos, body.iquat, body.inertia = own.ipos, own.iquat, own.inertia
        body.fullinertia = [np.nan, 0, 0, 0, 0, 0]
    return spec


UNPHYSICAL = ("adr", "num", "id", "dof_length")
"""Ends of names of what is no physics; the last is a length by which MuJoCo judges whether bodies sleep."""


KINDS = {"body": "nbody", "jnt": "njnt", "dof": "nv", "geom": "ngeom", "actuator": "nu"}
"""The first words of arrays, and how many rows they have."""


def numbers(model):
    """What physics is made of: arrays of numbers by field, rows by the elements' names; every joint has one dof."""
    found = {n: np.array(getattr(model.opt, n)) for n in ("timestep", "gravity", "density", "viscosity")}
    rows = {}
    for kind, count in KINDS.items():
        names = [getattr(model, {"jnt": "joint", "dof": "joint"}.get(kind, kind))(i).name
                 for i in range(getattr(model, count))]  # fmt: skip
        rows[kind] = [i for i in np.argsort(names) if names[i] not in SEEN]
    for field in (n for n in dir(model) if n.partition("_")[0] in KINDS and not n.endswith(UNPHYSICAL)):
        values = getattr(model, field)
        if isinstance(values, np.ndarray) and values.dtype.kind == "f":
            found[field] = values[rows[field.partition("_")[0]]]
    return found


def assert_alike(found, expected, told):
    for field, values in expected.items():
        if not np.allclose(found[field], values, rtol=1e-6, atol=1e-9, equal_nan=True):
            np.testing.assert_allclose(found[field], values, rtol=1e-6, atol=1e-9, err_msg=f"{told}: {field}")


@pytest.mark.parametrize(("option", "density"), CASES)
def test_what_every_effect_changes_survives_the_compiler(option, density, tmp_path):
    spec, reference = read(tmp_path, option, density), written_out(option, density)
    model = reference.copy().compile()
    nv, nu = np.ones(model.nv), np.ones(model.nu)
    stops = np.outer(nv, [-1.0, 1.5])
    typical = TypicalSizes(0.02, 0.1 * nv, nv, 0.5 * nv, 6.0 * nv, 0.5 * nu, 2.0 * nu, 0.2, stops=stops)
    nominal = numbers(spec.copy().compile())
    assert_alike(nominal, numbers(model), "as it is")
    found = all_candidates(spec, typical)
    assert {c.kind.name for c in found} == {e.name for e in EFFECTS.values() if e.searched}
    for c in found:
        effect = c.effect(c.starts[-1] if c.starts else np.array(c.nominal) + 0.3 * np.array(c.scale))
        edited, expected = spec.copy(), reference.copy()
        for s in (edited, expected):
            effect.apply(s)
        assert_alike(numbers(edited.compile()), numbers(expected.compile()), f"{c.label} at {effect}")


@pytest.mark.parametrize(("option", "density"), CASES)
def test_the_model_that_is_read_moves_as_mujoco_has_it(option, density, tmp_path):
    models = [raw(option, density).compile(), read(tmp_path, option, density).compile()]
    data = [mujoco.MjData(m) for m in models]
    for m, d in zip(models, data, strict=True):
        d.ctrl[:] = 0.3, 0.2, 1.0
        mujoco.mj_step(m, d, 100)
    np.testing.assert_allclose(data[1].qpos, data[0].qpos, rtol=1e-7, atol=1e-9)
