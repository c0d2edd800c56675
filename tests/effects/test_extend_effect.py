"""The effect that docs/guide/extend.md adds: the example there is run as it stands, and found when it is planted."""

import importlib
import re
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import idapt_pl
from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.candidates.listing import all_candidates
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.effects import EFFECTS, effect_from_dict
from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.effects.wording import phrase_at, unit_at

PAGE = Path(idapt_pl.__file__).parent.parent / "docs" / "guide" / "extend.md"
NAME, HIDDEN = "joint_hardening", 0.8

PENDULUM = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="pole"><joint name="swing" axis="0 1 0" damping="0.05" stiffness="{stiffness}"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.5" mass="0.5"/></body>
  </worldbody>
  <actuator><motor name="drive" joint="swing"/></actuator>
</mujoco>"""
NOMINAL = PENDULUM.format(stiffness=0)


@pytest.fixture(scope="module")
def kind(tmp_path_factory):
    """The class of the example, imported from a file as a user would; unregistered afterwards."""
    code = re.search(r"<!-- effect-example -->\n```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert code, f"{PAGE} has no example after <!-- effect-example -->"
    folder = tmp_path_factory.mktemp("extend")
    (folder / "my_effects.py").write_text(code[1], encoding="utf-8")
    assert NAME not in EFFECTS
    sys.path.insert(0, str(folder))
    try:
        yield importlib.import_module("my_effects").JointHardening
    finally:
        sys.path.remove(str(folder))
        sys.modules.pop("my_effects", None)
        EFFECTS.pop(NAME, None)


def test_importing_the_file_registers_the_effect(kind):
    assert EFFECTS[NAME] is kind and kind.__doc__.startswith("A spring")
    effect = kind("swing", 0.8)
    assert effect_from_dict(effect.to_dict()) == effect
    with pytest.raises(ValueError, match=r"hardening = -1.0 N·m/rad³ or N/m³ is outside"):
        kind("swing", -1.0)


def test_its_torque_is_the_law_in_its_docstring(kind):
    spec = mujoco.MjSpec.from_string(NOMINAL)
    kind("swing", 0.8).apply(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    for q in (-1.2, 0.5, 2.0):
        data.qpos[0] = q
        mujoco.mj_forward(model, data)
        assert data.qfrc_passive[0] == pytest.approx(-0.8 * q**3)


def test_reports_name_it_with_its_unit(kind):
    assert phrase_at(NAME, "swing") == "a hardening spring on joint swing"
    assert unit_at(mujoco.MjModel.from_xml_string(NOMINAL), "swing", "N·m/rad³ or N/m³") == "N·m/rad³"


def test_a_diagnosis_is_offered_it_at_what_the_model_has(kind):
    one, typical = np.ones(1), TypicalSizes(0.02, *np.ones((6, 1)), 0.2)
    for stiffness, nominal in (("0", 0.0), ("1 0 0.3", 0.3)):
        spec = mujoco.MjSpec.from_string(PENDULUM.format(stiffness=stiffness))
        (found,) = [c for c in all_candidates(spec, typical) if c.kind is kind]
        assert (found.target, found.names, found.nominal) == ("swing", ("hardening",), (nominal,))
        assert found.scale == pytest.approx(one / 0.2**2)


def recorded(xml, episodes=6, steps=60, dt=0.02):
    """Noisy recordings of a pendulum that random torques swing."""
    model, rng, made = mujoco.MjModel.from_xml_string(xml), np.random.default_rng(0), []
    for _ in range(episodes):
        data = mujoco.MjData(model)
        data.qpos[:] = rng.uniform(-1.5, 1.5)
        actions = np.repeat(rng.uniform(-1.5, 1.5, (steps // 5, 1)), 5, 0)
        states = [(data.qpos[0], data.qvel[0])]
        for a in actions:
            data.ctrl[:] = a
            mujoco.mj_step(model, data, round(dt / model.opt.timestep))
            states.append((data.qpos[0], data.qvel[0]))
        q, v = (np.array(states) + (1e-3, 1e-2) * rng.normal(size=(steps + 1, 2))).T
        made.append(Episode(actions.astype(np.float32), {"qpos": q[:, None], "qvel": v[:, None]}))
    return Trajectories(tuple(made), dt)


def test_a_diagnosis_finds_it_where_it_was_planted(kind):
    diagnosis = diagnose(mujoco.MjSpec.from_string(NOMINAL), recorded(PENDULUM.format(stiffness=f"0 0 {HIDDEN}")))
    (found,) = diagnosis.report["effects"]
    assert (diagnosis.verdict, found["effect"], found["target"]) == ("effects_found", NAME, "swing")
    value = found["parameters"]["hardening"]
    assert value["estimate"] == pytest.approx(HIDDEN, rel=0.05)
    assert value["ci95"][0] < HIDDEN < value["ci95"][1]


def test_a_diagnosis_does_not_find_it_where_it_is_not(kind):
    diagnosis = diagnose(mujoco.MjSpec.from_string(NOMINAL), recorded(NOMINAL))
    assert (diagnosis.verdict, diagnosis.report["effects"]) == ("no_missing_effect", [])
