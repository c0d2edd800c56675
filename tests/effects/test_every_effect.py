"""What every registered effect must have, whoever adds it: words, units, a page, and candidates for a diagnosis."""

import dataclasses
import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
import pytest

import idapt_pl
from idapt_pl.diagnosis.answer.repaired import repair_model
from idapt_pl.diagnosis.candidates.listing import all_candidates
from idapt_pl.effects.base import EFFECTS, Effect
from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.effects.joints import JointDamping
from idapt_pl.effects.runtime import Command, CommandEffect, ForceEffect, RuntimeEffect, SensingEffect
from idapt_pl.effects.visual import VisualEffect
from idapt_pl.effects.wording import phrase_at

DOCS = Path(idapt_pl.__file__).parent.parent / "docs"
OURS = [e for e in EFFECTS.values() if e.__module__.startswith("idapt_pl.")]
SEARCHED = [e for e in OURS if e.searched]

REFERENCE = """
<mujoco>
  <option timestep="0.002" density="1.2" viscosity="0.01"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="cart" pos="0 0 1"><joint name="slide" type="slide" axis="1 0 0" stiffness="3" damping="0.5"/>
      <geom name="box" type="box" size="0.1 0.2 0.3" mass="2"/>
      <body name="arm" pos="0 0 0.5"><joint name="hinge" axis="0 1 0" stiffness="2" springref="0.1" armature="0.01"/>
        <inertial pos="0 0 0.1" mass="2" diaginertia="0.1 0.2 0.25"/>
        <geom name="rod" type="capsule" size="0.05" fromto="0 0 0 0 0 0.4"/>
        <body name="hand" pos="0 0 0.4"><joint name="wrist" axis="0 1 0" stiffness="2"/>
          <geom name="palm" type="sphere" size="0.05" mass="0.3"/></body>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="slide" gear="2"/>
    <position name="hold" joint="hinge" kp="30" kv="0.5"/>
    <dcmotor name="turn" joint="wrist" motorconst="0.05" resistance="2" input="voltage"/></actuator>
</mujoco>"""
"""Every kind of element: hinges and a slide with springs, a motor, a servo, a DC motor, and geoms that touch."""


@pytest.fixture(scope="module")
def nominal():
    return mujoco.MjModel.from_xml_string(REFERENCE)


@pytest.fixture(scope="module")
def typical(nominal):
    nv, nu = np.ones(nominal.nv), np.ones(nominal.nu)
    stops = np.outer(nv, [-1.0, 1.5])
    return TypicalSizes(0.02, 0.1 * nv, nv, 0.5 * nv, 6.0 * nv, 0.5 * nu, 2.0 * nu, 0.2, stops=stops)


def numeric(field):
    """Whether a field of an effect holds numbers."""
    return bool(re.search(r"\b(float|int)\b", str(field.type)))


def parameters(kind):
    return [f for f in dataclasses.fields(kind) if f.name != "target"]


def page_row(kind):
    """The row of an effect in docs/reference/effects.md."""
    cells = [f"`{f.name}`" + (f" [{f.metadata['unit']}]" if numeric(f) else "") for f in parameters(kind)]
    return f"| `{kind.name}` | {kind.phrase} | {', '.join(cells)} | {'yes' if kind.searched else 'no'} |"


@pytest.mark.parametrize("kind", OURS, ids=lambda k: k.name)
def test_every_effect_says_what_it_is(kind):
    assert kind.phrase and kind.phrase == kind.phrase.strip()
    assert not kind.__doc__.startswith(f"{kind.__name__}("), "a docstring of its own, not that of a dataclass"


@pytest.mark.parametrize("kind", OURS, ids=lambda k: k.name)
def test_every_number_has_a_unit_and_bounds(kind):
    for f in parameters(kind):
        if numeric(f):
            assert f.metadata.get("unit"), f"{f.name}: declare it with parameter(unit, low, high)"
            assert f.metadata["low"] < f.metadata["high"]


@pytest.mark.parametrize("kind", OURS, ids=lambda k: k.name)
def test_every_effect_is_on_a_page(kind):
    pages = "\n".join(p.read_text(encoding="utf-8") for p in DOCS.rglob("*.md"))
    assert page_row(kind) in pages, "add this row to docs/reference/effects.md"


@pytest.mark.parametrize("kind", OURS, ids=lambda k: k.name)
def test_a_diagnosis_looks_for_every_effect_unless_its_class_says_why_not(kind, nominal, typical):
    found = kind.candidates(nominal, typical)
    if kind.searched:
        assert found, "the reference model has every kind of element"
        assert {c.kind for c in found} == {kind}
        return
    assert not found
    says = next(c for c in kind.__mro__ if "searched" in vars(c))
    assert says is not Effect and "diagnosis" in says.__doc__.lower(), "its docstring says why"


def test_only_what_is_seen_or_learned_or_has_a_twin_or_no_number_is_not_looked_for():
    unsought = {e.name for e in OURS if not e.searched and not issubclass(e, VisualEffect)}
    assert unsought == {"sensor_delay", "numerics", "learned_force", "residual_network"}


@pytest.mark.parametrize("kind", SEARCHED, ids=lambda k: k.name)
def test_candidates_are_well_formed(kind, nominal, typical):
    """Numbers for every parameter, finite, inside the bounds; the effect they make can be applied."""
    known = {f.name for f in parameters(kind)}
    for c in kind.candidates(nominal, typical):
        low, high = c.bounds()
        assert {*c.names, *dict(c.fixed)} <= known
        for x in (c.nominal, *c.starts):
            assert len(x) == c.size and (low <= x).all() and (x <= high).all(), (c.label, x)
        assert len(c.scale) == c.size and np.isfinite(c.scale).all() and (np.array(c.scale) > 0).all()
        assert all(c.units()) and 1 <= (c.strength or c.size) <= c.size
        effect = c.effect(np.add(c.nominal, c.scale))
        spec = mujoco.MjSpec.from_string(REFERENCE)
        effect.apply(spec)
        spec.compile()


def motion(spec):
    """Where a model gets in 0.2 s with constant commands, positions (3,)."""
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.3, 0.2, 1.0
    mujoco.mj_step(model, data, 100)
    return np.array([data.joint(name).qpos[0] for name in ("slide", "hinge", "wrist")])


@pytest.mark.parametrize("kind", SEARCHED, ids=lambda k: k.name)
def test_with_its_nominal_value_an_effect_changes_nothing(kind, nominal, typical):
    expected = motion(mujoco.MjSpec.from_string(REFERENCE))
    commands = Command(np.array([0.0, 1.0]), np.array([[0.3, 0.2, 1.0]]))
    q, v = np.array([[0.3, -0.2]]), np.array([[1.0, -2.0]])
    for c in kind.candidates(nominal, typical):
        effect, spec = c.effect(c.nominal), mujoco.MjSpec.from_string(REFERENCE)
        if isinstance(effect, CommandEffect):
            arrived = effect.transform(commands, effect.columns(nominal), 0.002)
            np.testing.assert_allclose(arrived.values[0], commands.values[0])
        elif isinstance(effect, ForceEffect):
            assert not np.any(effect.force(q, v, np.zeros(1)))
        elif isinstance(effect, SensingEffect):
            np.testing.assert_array_equal(effect.measure(q, v), (q, v))
        if isinstance(effect, RuntimeEffect):
            effect.constrain(spec)
        else:
            effect.apply(spec)
        np.testing.assert_allclose(motion(spec), expected, atol=1e-9, err_msg=c.label)


def test_every_class_with_a_name_is_registered_by_importing_the_package():
    """A class in a file of the package is enough; nothing lists the files."""
    folder = Path(idapt_pl.__file__).parent / "effects"
    written = {
        n for f in folder.glob("*.py") for n in re.findall(r'    name: ClassVar\[str\] = "(\w+)"', f.read_text())
    }
    assert written == {e.name for e in OURS}


def test_two_effects_with_one_name_are_refused():
    with pytest.raises(ValueError, match=r"JointDamping and .*Again are both called 'joint_damping': rename one"):

        @dataclass(frozen=True)
        class Again(JointDamping):
            """Damping, again."""

            name: ClassVar[str] = "joint_damping"

    assert EFFECTS["joint_damping"] is JointDamping


def test_a_class_that_only_builds_on_an_effect_does_not_take_its_place():
    @dataclass(frozen=True)
    class Halfway(JointDamping):
        """Damping that others build on."""

    assert Halfway.name == "joint_damping" and EFFECTS["joint_damping"] is JointDamping


@pytest.mark.parametrize(
    ("effect", "target", "words"),
    [
        ("joint_damping", "actuated", "viscous friction (damping) on all actuated joints"),
        ("payload", "hand", "a load on body hand"),
        ("color", "*", "colour of all geoms"),
        ("texture", "sky", "texture of the sky"),
        ("blur", "world", "blur of the images"),
        ("joint_unheard_of", "hinge", "joint unheard of of hinge"),
    ],
)
def test_phrases_name_the_target(effect, target, words):
    assert phrase_at(effect, target) == words


def test_all_candidates_are_those_of_all_effects(nominal, typical):
    spec = mujoco.MjSpec.from_string(REFERENCE)
    expected = [c for kind in EFFECTS.values() for c in kind.candidates(nominal, typical)]
    found = all_candidates(spec, typical)
    assert len(found) == len(expected) and sorted(map(repr, found)) == sorted(map(repr, expected))


@pytest.mark.parametrize("name", ["body_mass", "actuator_gain", "actuator_kp", "actuator_kv", "motor_constant"])
def test_where_a_search_starts_says_nothing_of_the_answer(name, nominal, typical):
    """The same ratios of nominal for all of them, as far down as up."""
    ratios = {
        tuple(np.round(np.divide(c.starts, c.nominal).ravel(), 9))
        for c in EFFECTS[name].candidates(nominal, typical)
        if c.nominal[0]
    }
    assert len(ratios) == 1
    logarithms = np.log(ratios.pop())
    assert len(logarithms) and sorted(logarithms) == pytest.approx(sorted(-logarithms))


def arrays(model):
    """All numbers of a compiled model but those that only say where other things lie."""
    skipped = ("adr", "num", "id", "simple", "sameframe", "plugin", "_bufs")
    names = (n for n in dir(model) if not n.startswith("_") and not n.endswith(skipped))
    found = {n: v for n in names if isinstance(v := getattr(model, n), np.ndarray) and v.dtype.kind == "f"}
    return found | {
        f"opt.{n}": np.asarray(getattr(model.opt, n)) for n in ("timestep", "gravity", "density", "viscosity")
    }


@pytest.mark.parametrize("kind", SEARCHED, ids=lambda k: k.name)
def test_what_an_effect_does_to_a_model_survives_being_written(kind, nominal, typical, tmp_path):
    """``patched.xml`` is what was fitted: a load of which MuJoCo writes no mass would be lost."""
    for c in kind.candidates(nominal, typical):
        effect = c.effect(c.starts[-1] if c.starts else np.array(c.nominal) + 0.3 * np.array(c.scale))
        spec = mujoco.MjSpec.from_string(REFERENCE)
        effect.apply(spec)
        written = repair_model(mujoco.MjSpec.from_string(REFERENCE), (effect,), tmp_path).patched
        loaded = arrays(mujoco.MjModel.from_xml_string(written))
        for name, value in arrays(spec.compile()).items():
            np.testing.assert_allclose(loaded[name], value, rtol=1e-4, atol=1e-7, err_msg=f"{effect}: {name}")
