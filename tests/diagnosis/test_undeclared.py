"""The recordings of the benchmark: valid, repeatable, made without the code under test, with the truth in them."""

import ast
import sys
from dataclasses import replace
from itertools import permutations

import mujoco
import numpy as np
import pytest
from conftest import ROOT

from datamodules import read_trajectories

sys.path.insert(0, str(ROOT))  # the benchmarks are not installed

from benchmarks.undeclared import hidden
from benchmarks.undeclared.cases import CASES, FINE, SAME
from benchmarks.undeclared.generate import effect_size, generate, simulate, true_model
from benchmarks.undeclared.models import ASSETS, MODELS, nominal_xml


@pytest.fixture(params=MODELS)
def nominal(request):
    return mujoco.MjModel.from_xml_string(nominal_xml(request.param))


def few_episodes(monkeypatch, model, episodes=2):
    monkeypatch.setitem(MODELS, model, replace(MODELS[model], episodes=episodes))


def test_the_benchmark_never_imports_the_code_under_test():
    files = sorted((ROOT / "benchmarks" / "undeclared").rglob("*.py"))
    assert len(files) >= 4
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.split(".")[0] in ("idapt_pl", "cli") for name in names), file


def test_there_are_enough_cases_of_each_kind():
    kinds = [case.kind for case in CASES.values()]
    assert all(name == case.name for name, case in CASES.items())
    assert len(kinds) - kinds.count("control") >= 40 and kinds.count("control") >= 12
    assert kinds.count("outside") >= 4 and kinds.count("confounded") >= 6 and kinds.count("double") >= 4
    assert {case.model for case in CASES.values()} == set(MODELS)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_truth_answers_and_parts_of_a_case_fit_together(case):
    model = true_model(case)
    assert model.opt.timestep > 0
    assert len(case.parts) == len(case.truth) and (case.kind == "control") == (not case.truth)
    assert (case.kind == "outside") == (not case.accept)
    known = mujoco.MjModel.from_xml_string(nominal_xml(case.model))
    names = {
        getattr(known, kind)(i).name
        for kind, n in (("joint", known.njnt), ("body", known.nbody), ("actuator", known.nu), ("geom", known.ngeom))
        for i in range(n)
    } | {"*", "world"}
    names |= {f"{known.joint(i).name} {known.joint(j).name}" for i, j in permutations(range(known.njnt), 2)}
    assert all(target in names for answer in case.accept for _, target in answer)
    assert all(truth.target in names for truth in case.truth)


def test_everything_in_a_nominal_model_has_a_name(nominal):
    for kind, count in (("joint", nominal.njnt), ("body", nominal.nbody), ("actuator", nominal.nu)):
        assert all(getattr(nominal, kind)(i).name for i in range(count))
    assert all(nominal.geom(i).name for i in range(nominal.ngeom))


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("inverted_pendulum", "inverted_pendulum.xml"),
        ("half_cheetah", "half_cheetah.xml"),
        ("walker2d", "walker2d_v5.xml"),
        ("reacher", "reacher.xml"),
    ],
)
def test_nominal_models_are_gymnasiums(name, file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs a deprecated attribute of the asset to the working directory
    ours = mujoco.MjModel.from_xml_string(nominal_xml(name))
    theirs = mujoco.MjModel.from_xml_path(str(ASSETS / file))
    for field in ("body_mass", "body_inertia", "body_ipos", "dof_damping", "dof_armature", "actuator_gear"):
        np.testing.assert_allclose(getattr(ours, field), getattr(theirs, field), atol=1e-8)


def test_files_load_and_repeat_by_seed(tmp_path, monkeypatch):
    few_episodes(monkeypatch, "servo_arm")
    case = CASES["servo_elbow_frictionloss"]
    (xml, first), (_, again), (_, other) = (
        generate(case, seed, tmp_path / folder) for seed, folder in ((0, "a"), (0, "b"), (1, "c"))
    )
    model = mujoco.MjModel.from_xml_path(str(xml))
    assert model.joint("elbow").frictionloss[0] == pytest.approx(0.04), "the nominal file does not know the truth"
    one, two, three = (read_trajectories(path) for path in (first, again, other))
    assert one.dt == pytest.approx(0.02) and len(one) == 2
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.actions, b.actions)
        np.testing.assert_array_equal(a.observations["qpos"], b.observations["qpos"])
        assert a.observations["qvel"].shape == (len(a) + 1, model.nv)
        low, high = model.actuator_ctrlrange.T
        assert ((a.actions >= low) & (a.actions <= high)).all()
    assert not np.array_equal(one.episodes[0].actions[:20], three.episodes[0].actions[:20])
    assert "frictionloss" not in one.source and "elbow" not in one.source


@pytest.mark.parametrize("name", [n for n, c in CASES.items() if c.kind == "control" and c.numerics == SAME])
def test_a_control_with_the_same_numerics_is_the_nominal_simulation_plus_noise(name, monkeypatch):
    case = CASES[name]
    few_episodes(monkeypatch, case.model, 1)
    (recording,) = simulate(case, 0)
    model = mujoco.MjModel.from_xml_string(nominal_xml(case.model))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = np.split(recording.clean[0], [model.nq])
    for action, after in zip(recording.actions, recording.clean[1:], strict=True):
        data.ctrl[:] = action
        mujoco.mj_step(model, data, MODELS[case.model].frame_skip)
        np.testing.assert_allclose(np.concatenate([data.qpos, data.qvel]), after, atol=1e-9)
    apart, noise = np.zeros((len(recording.clean), 2, model.nv)), case.noise
    for row, one, other in zip(apart, recording.measured, recording.clean, strict=True):
        mujoco.mj_differentiatePos(model, row[0], 1.0, other[: model.nq], one[: model.nq])
        row[1] = one[model.nq :] - other[model.nq :]
    error = apart.std(axis=0) / np.array([[np.hypot(noise.qpos, noise.quantum / np.sqrt(12))], [noise.qvel]])
    assert (error > 0.4).all() and (error < 1.6).all()


@pytest.mark.parametrize(
    ("name", "rival"),
    [
        ("cheetah_bthigh_springref", hidden.command_bias("bthigh", 0.12)),
        ("pendulum_cart_force", hidden.command_bias("slide", -0.12)),
        ("servo_yaw_armature", hidden.body_mass("turret", 1.2 * (1 + 0.02 / 0.006))),
    ],
)
def test_the_members_of_a_class_make_the_same_data(name, rival, monkeypatch):
    case = replace(CASES[name], numerics=FINE)
    few_episodes(monkeypatch, case.model, 1)
    assert {(rival.truth.effect, rival.truth.target)} in case.accept
    (truth,), (other,), (nothing,) = (simulate(replace(case, parts=p), 0) for p in (case.parts, (rival,), ()))
    np.testing.assert_allclose(truth.clean[:10], other.clean[:10], atol=1e-6)
    assert np.abs(truth.clean[:10] - nothing.clean[:10]).max() > 1e-3


@pytest.mark.parametrize("name", ["pendulum_hinge_damping", "reacher_joint0_deadzone", "servo_elbow_stribeck"])
def test_a_hidden_effect_stands_out_of_the_noise_and_nothing_does_not(name, monkeypatch):
    case = CASES[name]
    few_episodes(monkeypatch, case.model)
    assert effect_size(case, 0, stride=10).rms > 3
    assert effect_size(replace(case, parts=()), 0, stride=10).rms < 1e-6


def test_delayed_sensors_show_the_past(monkeypatch):
    case = CASES["servo_sensor_delay"]
    few_episodes(monkeypatch, case.model, 1)
    late, prompt = replace(case, parts=(hidden.sensor_delay(0.02),)), replace(case, parts=())
    np.testing.assert_array_equal(simulate(late, 0)[0].clean[1:], simulate(prompt, 0)[0].clean[:-1])


def test_backlash_hides_a_joint_and_shows_the_link(monkeypatch):
    case = CASES["servo_elbow_backlash"]
    few_episodes(monkeypatch, case.model, 1)
    assert true_model(case).nq == 4
    assert simulate(case, 0)[0].clean.shape[1] == 6
