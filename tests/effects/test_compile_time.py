"""What the compiler does to masses must not undo what effects do."""

import mujoco
import numpy as np
import pytest

from idapt_pl.effects import Domain
from idapt_pl.effects.bodies import BodyInertia, BodyMass
from idapt_pl.effects.compile_time import write_out_masses
from idapt_pl.prediction.model import read_model
from idapt_pl.tasks import make_task

ARM = """<mujoco><compiler {}/><worldbody><geom type="plane" size="1 1 1"/>
<body name="upper"><joint name="shoulder" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 1" size="0.05"/>
<body name="lower" pos="0 0 1"><joint name="elbow" axis="0 1 0"/>
<inertial pos="0 0 0.3" mass="0.7" diaginertia="0.011 0.02 0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 0.6" size="0.04"/></body></body></worldbody></mujoco>"""

COMPILERS = ['settotalmass="30"', 'boundmass="2"', 'boundinertia="0.5"', 'balanceinertia="true"',
             'inertiafromgeom="true"', 'settotalmass="5" boundmass="1" inertiafromgeom="true"', ""]  # fmt: skip


def arm(compiler):
    xml = ARM.format(compiler)
    if "balance" in compiler:
        xml = xml.replace("0.011 0.02", "0.011 0.03")  # which no body has
    return mujoco.MjSpec.from_string(xml)


def compiled(compiler, *effects):
    return Domain("arm", lambda: arm(compiler), effects).compile()


@pytest.mark.parametrize("compiler", COMPILERS)
def test_masses_that_are_written_out_compile_to_the_same_model(compiler):
    spec = arm(compiler)
    before = spec.copy().compile()
    write_out_masses(spec)
    after = spec.compile()
    for name in ("body_mass", "body_inertia", "body_ipos"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=1e-9, atol=1e-12)
    data = [mujoco.MjData(m) for m in (before, after)]
    for m, d in zip((before, after), data, strict=True):
        d.qpos[:] = 0.3
        mujoco.mj_step(m, d, 50)
    np.testing.assert_allclose(data[0].qpos, data[1].qpos, rtol=1e-9)


@pytest.mark.parametrize("compiler", COMPILERS)
def test_a_mass_is_what_the_effect_says_and_no_other_body_changes(compiler):
    nominal = compiled(compiler)
    for target in ("upper", "lower"):
        heavier = compiled(compiler, BodyMass(target, 9.0))
        i = nominal.body(target).id
        assert heavier.body_mass[i] == pytest.approx(9.0)
        np.testing.assert_allclose(np.delete(heavier.body_mass, i), np.delete(nominal.body_mass, i), rtol=1e-9)
        ratio = 9.0 / nominal.body_mass[i]
        np.testing.assert_allclose(heavier.body_inertia[i], nominal.body_inertia[i] * ratio, rtol=1e-9)
    doubled = compiled(compiler, BodyInertia("lower", mass=2.0))
    assert doubled.body("lower").mass == pytest.approx(2 * nominal.body("lower").mass)


@pytest.mark.parametrize("task", ["gymnasium:HalfCheetah-v5", "dm_control:cheetah/run"])
def test_a_cheetah_with_a_fixed_total_mass_can_have_a_heavier_torso(task):
    source = make_task(task).domain("source")
    nominal, heavier = source.compile().body_mass, source.with_effects(BodyMass("torso", 12.0)).compile().body_mass
    assert heavier[1] == pytest.approx(12.0)
    np.testing.assert_allclose(heavier[2:], nominal[2:], rtol=1e-9)


def test_a_model_that_is_diagnosed_has_them_written_out(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format('settotalmass="30"'))
    spec = read_model(path)
    assert spec.compiler.settotalmass == -1
    BodyMass("upper", 40.0).apply(spec)
    assert spec.compile().body("upper").mass == pytest.approx(40.0)
