"""The privileged teacher: labels, learning from them, going on from them, and what a run with it leaves."""

import json
import shutil
from contextlib import closing
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from conftest import TINY

from cli.main import main
from datamodules import ReplayBuffer, ReplayDataModule
from idapt_pl.effects.actuators import ActuatorGain
from idapt_pl.envs import GroundedEnv, StatesOnly, VectorImageEnv, VectorStateEnv
from idapt_pl.envs.ledger import Ledger
from idapt_pl.modules import AsymmetricSAC, Imitation, StateSAC
from idapt_pl.report.run_record import ORDER
from idapt_pl.rl.dagger import DaggerExperience, teacher_labels
from idapt_pl.rl.experts import fit_expert
from idapt_pl.rl.noisy_teacher import MisledTeacher, noisy_return
from idapt_pl.rl.strays import Strays
from idapt_pl.stage import Stages, cpu_trainer
from idapt_pl.stages import distillation
from idapt_pl.stages.collection import explorer
from idapt_pl.stages.distillation import (
    LABELLED,
    Distillation,
    TeacherSettings,
    copy_critics,
)
from idapt_pl.targets import SimulatedTarget
from idapt_pl.tasks import make_task
from idapt_pl.tasks.recipe import ExpertRecipe
from idapt_pl.worlds import Worlds

SIZES = {"state_dim": 2, "action_low": [-100.0], "action_high": [100.0], "hidden": (16,)}


def image_policy(**kwargs):
    return AsymmetricSAC(**SIZES, image_size=16, frame_stack=2, bf16=False, **kwargs)


@pytest.fixture
def teacher():
    policy = StateSAC(**SIZES)
    policy.actor.encoder.fit(torch.tensor([[-0.3, -2.0], [0.3, 2.0]]))
    policy.actor.head[-1].weight.data[:1] *= 3  # so that it means something
    return policy


@pytest.fixture
def env(cart):
    env = GroundedEnv(VectorImageEnv(cart, cart.domain("source"), 2, 16, 2))
    yield env
    env.close()


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6, 0.9])
def test_strays_take_the_share_that_was_asked_for(share, env):
    strays, chosen = Strays(env, share, seed=1), np.zeros((2, 1))
    played = np.array([strays(chosen) for _ in range(8000)])
    assert (played != 0).mean() == pytest.approx(share, abs=0.03)


def test_strays_take_their_share_of_the_steps_are_held_and_stay_within_bounds(env, teacher):
    played, strays = np.zeros((4000, 2, 1)), Strays(env, 0.3, seed=1)
    chosen = np.zeros((2, 1))
    for t in range(len(played)):
        played[t] = strays(chosen)
    strayed = played != 0
    assert 0.25 < strayed.mean() < 0.35 and 50 < np.abs(played).max() <= 100
    for sim in played[:, :, 0].T:
        runs = np.diff(np.flatnonzero(np.append(np.insert(np.diff(sim) != 0, 0, True), True)))
        held = runs[[sim[i] != 0 for i in np.cumsum(runs) - 1]]
        assert held.min() >= 1 and held.max() == Strays.LONGEST
    assert (Strays(env, 0.0, seed=1)(chosen) == chosen).all()
    lessons = DaggerExperience(env, image_policy(encoder="supervised"), teacher, 0, 5, images=True, strays=0.5)
    seen = np.concatenate([lessons()["label"] for _ in range(8)])
    assert np.abs(seen).max() <= 1  # labels are the teacher's, whoever acted


def test_labels_are_what_the_teacher_does_on_the_true_states(env, teacher):
    lessons = DaggerExperience(env, image_policy(encoder="supervised"), teacher, seed=0, fading=5, images=True)
    for _ in range(8):
        lesson = lessons()
        expected = teacher.act(lesson["state"], deterministic=True)
        np.testing.assert_allclose(100 * lesson["label"], expected, rtol=1e-5)
        assert lesson["pixels"].shape == (2, 2, 16, 16, 3) and lesson["observation"].shape == (2, 2)


def test_the_teacher_acts_first_and_the_student_last(env, teacher, monkeypatch):
    student = image_policy()
    monkeypatch.setattr(teacher, "act", lambda states, **_: np.full((2, 1), 7.0, np.float32))
    monkeypatch.setattr(student, "act_on", lambda seen: np.full((2, 1), -7.0, np.float32))
    played, step = [], env.step
    monkeypatch.setattr(env, "step", lambda actions: played.append(actions.copy()) or step(actions))
    lessons = DaggerExperience(env, student, teacher, seed=0, fading=20, images=False)
    for _ in range(40):
        assert set(lessons()) == set(LABELLED)
    played = np.asarray(played)
    assert (played[0] == 7).all() and (played[21:] == -7).all() and lessons.share == 0
    assert set(np.unique(played[5:15])) == {-7.0, 7.0}, "in between it is either"


class SameLessons:
    """Gives the same few lessons again and again."""

    share, recent_return = 0.25, 0.0

    def __init__(self, lessons, calls=8):
        given = [lessons() for _ in range(calls)]
        self.lessons = {k: np.concatenate([g[k] for g in given]) for k in given[0]}

    def __call__(self):
        return self.lessons


@pytest.mark.parametrize("encoder", ["learned", "supervised"])
def test_the_student_learns_what_the_teacher_does(env, teacher, trainer, encoder):
    student, images = image_policy(encoder=encoder, lr=1e-2, lr_estimator=1e-2), 2 if encoder == "supervised" else 0
    critics = {k: v.clone() for k, v in student.critic.state_dict().items()}
    lessons = SameLessons(DaggerExperience(env, student, teacher, 0, 20, images > 0))
    fit = trainer(100)
    fit.fit(
        Imitation(student), datamodule=ReplayDataModule(lessons, ReplayBuffer(16, 0), 16, 2, 100, images, 16, LABELLED)
    )
    names = ["imitation/action_error", "imitation/spread_error"] + ["policy/state_error"] * (images > 0)
    for name in names:
        assert fit.history[-1][name] < 0.5 * fit.history[0][name], name
    assert fit.history[-1]["imitation/teacher_share"] == 0.25
    assert all(torch.equal(v, critics[k]) for k, v in student.critic.state_dict().items())


def test_critics_handed_over_value_raw_states_as_the_teachers_value_standardised_ones(teacher):
    policy = image_policy()
    copy_critics(teacher, policy)
    states, actions = torch.tensor([[0.1, -0.5], [0.2, 1.5]]), torch.tensor([[30.0], [-80.0]])
    for name in ("critic", "critic_target"):
        expected = getattr(teacher, name)(teacher.actor.encoder(states), actions)
        torch.testing.assert_close(getattr(policy, name)(states, actions), expected)
    assert policy.log_alpha == teacher.log_alpha


def test_labels_do_not_depend_on_how_actions_are_scaled(teacher):
    states = np.array([[0.1, -0.5]], np.float32)
    told = teacher_labels(teacher, states)
    mean, log_std = teacher.actor.gaussian(teacher.encode(states))
    assert told["label"] == pytest.approx(torch.tanh(mean).item())
    assert told["label_log_std"] == pytest.approx(log_std.item(), abs=1e-6)


def test_an_environment_of_states_plays_as_the_grounded_source_behind_it(cart):
    def push(pixels, actions):
        return 0.5 * actions

    def make():
        return GroundedEnv(VectorImageEnv(cart, cart.domain("source"), 2, 8, 1), F=push)

    behind, shown = make(), StatesOnly(make())
    np.testing.assert_array_equal(behind.reset(seed=1)[0]["state"], shown.reset(seed=1)[0]["pixels"])
    for _ in range(8):
        a, b = (env.step(np.full((2, 1), 80, np.float32)) for env in (behind, shown))
        np.testing.assert_array_equal(a[0]["state"], b[0]["pixels"])
        np.testing.assert_array_equal(a[1], b[1])
        assert ("final_obs" in a[4]) == ("final_obs" in b[4])
        if "final_obs" in a[4]:
            np.testing.assert_array_equal(a[4]["final_obs"]["state"], b[4]["final_obs"]["pixels"])
    behind.close(), shown.close()


@pytest.fixture
def teaching(cart, tmp_path, monkeypatch):
    recipe = ExpertRecipe(steps=1, warmup_steps=10, num_envs=2, batch=8)
    monkeypatch.setattr(type(cart), "expert", recipe)
    worlds = Worlds(
        cart, cart.domain("source"), SimulatedTarget(cart, cart.domain("hard")), Ledger(tmp_path / "ledger.json"), 16, 2
    )
    stages = Stages(tmp_path, 0, cpu_trainer)
    return Distillation(worlds, stages, TeacherSettings(20, 20, 20), num_envs=2, batch=8, memory=100)


def test_the_teacher_goes_on_where_the_dynamics_are_new_and_only_there(teaching, tmp_path):
    student = partial(teaching.student, build=image_policy, make_env=lambda device: teaching.worlds.grounded(2))
    source = student(0, "source_")
    first = teaching.expert
    student(0, "")
    assert teaching.expert is first, "G alone changes no dynamics"
    teaching.worlds.add_effects([])
    assert type(source) is AsymmetricSAC and not list(tmp_path.rglob("step_00/teacher"))

    class Halving(torch.nn.Module):
        """Stands for F."""

    student(1, "", F=Halving())
    assert teaching.expert is not first and (tmp_path / "step_01/teacher/final.ckpt").exists()
    assert torch.equal(teaching.expert.actor.encoder.mean, first.actor.encoder.mean), "its scale stays"


@pytest.mark.parametrize(("wrong", "said"), [({"steps": 5}, "Give both"), ({"dagger": 5}, "Give both"),
                                             ({"fading": 0.0}, "above 0")])  # fmt: skip
def test_half_a_teacher_is_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        TeacherSettings(**wrong)


# --- in a run -------------------------------------------------------------------------------------------


def stages_of(run):
    return {(s["step"], s["stage"]) for s in json.loads((run / "summary.json").read_text())["stages"]}


def checkpoint(run, name):
    return torch.load(run / name / "final.ckpt", weights_only=True)["state_dict"]


@pytest.fixture(scope="module")
def taught_run(tmp_path_factory, tiny_args):
    run = tmp_path_factory.mktemp("runs") / "taught"
    overrides = {"teacher__steps": 16, "teacher__adapt": 12, "teacher__dagger": 16, "schedule__grounding_steps": 1}
    args = tiny_args(run, **overrides)
    assert main(["fit", *args]) == 0
    return run, args


def test_a_run_with_a_teacher_adds_stages_and_changes_none_before_them(taught_run, finished_run):
    run, _ = taught_run
    added = {(0, "source_teacher"), (0, "source_student"), (0, "student"), (1, "teacher"), (1, "student")}
    without = {(k, s) for k, s in stages_of(finished_run) if k <= 1}
    assert stages_of(run) == without | added and not added & stages_of(finished_run)
    for name in ("step_00/state_predictor", "step_00/visual"):  # they do not see the policy
        a, b = checkpoint(run, name), checkpoint(finished_run, name)
        assert all(torch.equal(a[k], b[k]) for k in a)


def test_the_report_knows_where_every_stage_of_a_taught_run_stands(taught_run):
    assert {name for _, name in stages_of(taught_run[0])} <= set(ORDER)


def test_a_teacher_costs_no_target_interactions(taught_run):
    summary = json.loads((taught_run[0] / "summary.json").read_text())
    assert summary["target_interactions"] == TINY["schedule.images"] + TINY["schedule.interactions"]


@pytest.mark.slow
def test_the_policys_sac_goes_on_from_the_student(taught_run, tiny_args, tmp_path):
    run = tmp_path / "student"
    overrides = {"teacher__steps": 16, "teacher__adapt": 12, "teacher__dagger": 16, "schedule__grounding_steps": 0}
    none = {"schedule__source_policy": 0, "schedule__pretrain__policy": 0}
    assert main(["fit", *tiny_args(run, **overrides, **none)]) == 0
    student, policy = checkpoint(run, "step_00/student"), checkpoint(run, "step_00/policy")
    assert all(torch.equal(v, student[f"policy.{k}"]) for k, v in policy.items())
    taught = checkpoint(taught_run[0], "step_00/policy")
    assert any(not torch.equal(v, policy[k]) for k, v in taught.items())


def test_a_taught_run_that_lost_its_last_step_repeats_it_bitwise(taught_run):
    run, args = taught_run
    before = {n: checkpoint(run, f"step_01/{n}") for n in ("teacher", "student", "policy")}
    (run / "step_01/student/final.ckpt").unlink()
    (run / "step_01/policy/final.ckpt").unlink()
    assert main(["fit", *args]) == 0
    for name, kept in before.items():
        again = checkpoint(run, f"step_01/{name}")
        assert all(torch.equal(v, again[k]) for k, v in kept.items()), name


def test_of_several_teachers_the_one_goes_on_that_earns_most_in_the_repaired_source(teaching, tmp_path):
    teaching.settings = replace(teaching.settings, candidates=3, noise=0.1)
    student = partial(teaching.student, build=image_policy, make_env=lambda device: teaching.worlds.grounded(2))
    student(0, "source_")
    assert not (tmp_path / "step_00/source_teacher_2").exists(), "one teacher of the plain source is enough"
    teaching.worlds.add_effects([ActuatorGain("push", 0.8)])
    student(0, "")
    trials = json.loads((tmp_path / "step_00/teacher_trials.json").read_text())
    assert len(trials["returns"]) == 3 and trials["chosen"] == int(np.argmax(trials["returns"]))
    kept = [checkpoint(tmp_path, f"step_00/{n}") for n in ("teacher", "teacher_2", "teacher_3")]
    weights = teaching.expert.state_dict()
    same = [all(torch.equal(weights[k], v) for k, v in each.items()) for each in kept]
    assert same == [i == trials["chosen"] for i in range(3)], "the three differ, and the best is the expert"


def test_the_last_of_several_teachers_begin_afresh(teaching, monkeypatch):
    """The others go on from what was learned in the plain source."""
    teaching.settings = replace(teaching.settings, candidates=3, afresh=2)
    student = partial(teaching.student, build=image_policy, make_env=lambda device: teaching.worlds.grounded(2))
    student(0, "source_")
    known, begun = teaching.expert.state_dict(), {}

    def fit(build, make, recipe, stages, step, name, fresh):
        going_on = all(torch.equal(v, known[k]) for k, v in build().state_dict().items())
        assert fresh != going_on, "what begins anew warms up with random actions and takes its scale from them"
        begun[name] = fresh
        return fit_expert(build, make, recipe, stages, step, name, fresh)

    monkeypatch.setattr(distillation, "fit_expert", fit)
    teaching.worlds.add_effects([ActuatorGain("push", 0.8)])
    student(0, "")
    assert begun == {"teacher": False, "teacher_2": True, "teacher_3": True}


def test_teachers_of_a_repaired_source_train_in_episodes_that_are_cut_and_are_compared_in_whole_ones(
    teaching, monkeypatch
):
    cuts = []
    teaching.settings = replace(teaching.settings, candidates=2, horizon=5)
    student = partial(teaching.student, build=image_policy, make_env=lambda device: teaching.worlds.grounded(2))
    make = type(teaching.worlds).training_states
    monkeypatch.setattr(
        type(teaching.worlds), "training_states", lambda self, n, cut=0: (cuts.append(cut), make(self, n, cut))[1]
    )
    student(0, "source_")
    teaching.worlds.add_effects([ActuatorGain("push", 0.8)])
    student(0, "")
    assert cuts == [0, 5, 5, 0]


def test_no_more_teachers_begin_afresh_than_there_are():
    with pytest.raises(ValueError, match=r"afresh.* 3"):
        TeacherSettings(steps=10, dagger=10, candidates=2, afresh=3)


@pytest.mark.parametrize(("reached", "stages"), [(True, 1), (False, 3)])
def test_a_teacher_that_never_reaches_the_goal_in_the_source_is_tried_again(
    teaching, tmp_path, monkeypatch, reached, stages
):
    kind = type(teaching.worlds.task)
    monkeypatch.setattr(kind, "metric", "success")
    monkeypatch.setattr(kind, "success", lambda self, model, data: reached)
    student = partial(teaching.student, build=image_policy, make_env=lambda device: teaching.worlds.grounded(2))
    student(0, "source_")
    rates = [json.loads(p.read_text())["success"] for p in sorted(tmp_path.rglob("source_teacher_success*.json"))]
    assert rates == [float(reached)] * stages
    assert len(list(tmp_path.rglob("source_teacher*/final.ckpt"))) == stages


@pytest.mark.parametrize(("share", "said"), [(0.97, "97 % of 100"), (0.6, "the best one in 60 %")])
def test_how_often_the_teacher_reaches_the_goal_is_said(teaching, monkeypatch, caplog, share, said):
    kind = type(teaching.worlds.task)
    monkeypatch.setattr(kind, "metric", "success")
    monkeypatch.setattr(kind, "success", lambda self, model, data: False)
    monkeypatch.setattr(Distillation, "success", lambda self, step, name, teacher: share)
    teaching.settings = replace(teaching.settings, attempts=2)
    with caplog.at_level("INFO"):
        teaching.student(0, "source_", image_policy, lambda device: teaching.worlds.grounded(2))
    assert said in caplog.text and ("teacher.steps" in caplog.text) == (share < 0.9)


def test_of_several_attempts_the_one_that_succeeds_goes_on(teaching, tmp_path, monkeypatch):
    kind = type(teaching.worlds.task)
    monkeypatch.setattr(kind, "metric", "success")
    monkeypatch.setattr(kind, "success", lambda self, model, data: False)
    told = iter([0.6, 0.96])
    monkeypatch.setattr(Distillation, "success", lambda self, step, name, teacher: next(told))
    student = partial(teaching.student, build=image_policy, make_env=lambda device: teaching.worlds.grounded(2))
    student(0, "source_")
    kept = checkpoint(tmp_path, "step_00/source_teacher_2")
    assert not (tmp_path / "step_00/source_teacher_3").exists()
    assert all(torch.equal(v, kept[k]) for k, v in teaching.expert.state_dict().items())


def test_teachers_beside_the_first_one_are_the_same(teaching, tmp_path):
    """Those set aside begin before the first one, end in files of their own and are asked for after it."""
    teaching.settings = replace(teaching.settings, candidates=3)
    student = partial(teaching.student, build=image_policy, make_env=lambda device: teaching.worlds.grounded(2))
    student(0, "source_")
    teaching.worlds.add_effects([ActuatorGain("push", 0.8)])
    before, asked = (teaching.expert, teaching._dynamics), []

    def later(name, last, work):
        assert not (tmp_path / "step_00/teacher/final.ckpt").exists()

        def result():
            asked.append((name, last.relative_to(tmp_path).as_posix()))
            return work()

        return result

    student(0, "")
    names = ("teacher", "teacher_2", "teacher_3")
    in_turn = [checkpoint(tmp_path, f"step_00/{n}") for n in names]
    shutil.rmtree(tmp_path / "step_00")
    (teaching.expert, teaching._dynamics), teaching.aside = before, later
    student(0, "")
    assert asked == [(f"{n}_of_step_0", f"step_00/{n}/final.ckpt") for n in names[1:]]
    for name, kept in zip(names, in_turn, strict=True):
        again = checkpoint(tmp_path, f"step_00/{name}")
        assert all(torch.equal(v, again[k]) for k, v in kept.items()), name


def test_a_misled_teacher_sees_other_states_in_every_episode(cart):
    teacher = StateSAC(2, [-100.0], [100.0], hidden=[8], noise=0.0, offset=0.5)
    act, states = MisledTeacher(teacher, 3, 0), np.ones((3, 2), np.float32)
    first = act(states)
    np.testing.assert_array_equal(first, act(states))  # an offset stays
    act.tick(np.array([False, True, False]))
    again = act(states)
    assert np.array_equal(first == again, [[True], [False], [True]])
    assert not np.allclose(first, teacher.act(states, deterministic=True))
    with closing(VectorStateEnv(cart, cart.domain("source"), 4)) as env:
        assert noisy_return(teacher, env, 8, 1) == noisy_return(teacher, env, 8, 1)


def test_a_teacher_counts_the_simulations_that_it_acts_in():
    """Behind an F they are those of the student's environment, else the task's."""
    task = SimpleNamespace(expert=ExpertRecipe(100, num_envs=4))
    teaching = SimpleNamespace(worlds=SimpleNamespace(task=task), num_envs=16)
    for F, number in ((None, 4), (object(), 16)):
        recipe = Distillation.recipe(teaching, F, gamma=0.9, steps=50)
        assert (recipe.num_envs, recipe.gamma, recipe.steps) == (number, 0.9, 50)


def test_an_explorers_teacher_acts_in_the_source_with_its_known_effects_and_without_those_found_later(monkeypatch):
    task, acted = make_task("inverted_pendulum"), []
    known, found = ActuatorGain("slide", 0.5), ActuatorGain("slide", 0.25)
    source = task.domain("source")
    worlds = Worlds(task, source, SimulatedTarget(task, source), None, 32, 3, known_effects=(known,))
    worlds.add_effects([known])
    worlds.add_effects([found])
    monkeypatch.setattr("idapt_pl.stages.collection.VectorStateEnv", lambda task, domain, n: acted.append(domain))
    monkeypatch.setattr("idapt_pl.stages.collection.OpenLoopReplay", lambda teacher, env, seed, strays: None)
    context = SimpleNamespace(worlds=worlds, teacher=SimpleNamespace(of_the_source=lambda build: None), new_policy=None)
    explorer(context, "rehearse", 0)
    assert [domain.effects[len(source.effects) :] for domain in acted] == [(known,)]
    assert worlds.added_effects == (known, found)
