"""The teacher on estimates: its own head, memory while it acts, rehearsals, and what a run with it leaves."""

import copy
import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from conftest import TINY

from cli.main import main
from datamodules import Episode, Trajectories, write_trajectories
from datamodules.unpaired import read_all
from idapt_pl.envs import GroundedEnv, VectorImageEnv
from idapt_pl.evaluation.estimates import EstimateErrors
from idapt_pl.modules import AsymmetricSAC, StateSAC
from idapt_pl.modules.observation_noise import RecordedErrors, SlowNoise
from idapt_pl.report.run_record import read_run_record
from idapt_pl.rl.policy import MUCH_LOST, Acting, deterministic, warn_if_lost
from idapt_pl.rl.rehearsal import Rehearsal
from idapt_pl.rl.returns import evaluate
from idapt_pl.smoothing import Smoothed
from idapt_pl.stages.labels import labelled, losses, warn_of_losses
from idapt_pl.stages.on_estimates import errors_of_estimates, in_rehearsals, read_episodes, take_over
from idapt_pl.stages.schedule import StageLengths

SIZES = {"state_dim": 2, "action_low": [-100.0], "action_high": [100.0], "hidden": (16,)}


@pytest.fixture
def teacher():
    policy = StateSAC(**SIZES)
    policy.actor.encoder.fit(torch.randn(50, 2) * torch.tensor([0.3, 2.0]) + 0.1)
    policy.actor.head[-1].weight.data[:1] *= 3  # so that it means something
    return policy


@pytest.fixture
def policy():
    made = AsymmetricSAC(**SIZES, image_size=16, frame_stack=2, encoder="supervised", memory=8, bf16=False)
    made.actor.encoder.fit_scale(torch.randn(50, 2) * torch.tensor([0.1, 3.0]) - 0.2)
    torch.nn.init.normal_(made.filter.correction[-1].weight, std=0.3)
    return made


@pytest.fixture
def env(cart):
    made = GroundedEnv(VectorImageEnv(cart, cart.domain("source"), 2, 16, 2))
    yield made
    made.close()


def test_on_true_states_the_policy_does_what_its_teacher_does(teacher, policy):
    take_over(teacher, policy)
    states = torch.randn(40, 2) * torch.tensor([0.3, 2.0])
    mine = policy.actor(policy.actor.encoder.standardise(states), deterministic=True)[0]
    np.testing.assert_allclose(mine.detach(), teacher.act(states.numpy(), deterministic=True), rtol=1e-4, atol=1e-3)
    actions = torch.rand(40, 1) * 200 - 100
    torch.testing.assert_close(
        policy.critic(states, actions), teacher.critic(teacher.actor.encoder(states), actions), rtol=1e-4, atol=1e-5
    )


def test_acting_remembers_until_an_episode_ends(env, policy):
    act = deterministic(policy)
    pixels = env.reset(seed=0)[0]["pixels"]
    first = act(pixels)
    second = act(pixels)
    assert (first != second).all(), "the same picture, another past"
    act.tick(np.array([True, False]))
    third = act(pixels)
    assert third[0] == pytest.approx(first[0], rel=1e-5) and third[1] != pytest.approx(first[1], rel=1e-5)


def test_a_policy_without_a_filter_remembers_nothing(env):
    act = Acting(AsymmetricSAC(**SIZES, image_size=16, frame_stack=2, bf16=False), deterministic=True)
    pixels = env.reset(seed=0)[0]["pixels"]
    np.testing.assert_array_equal(act(pixels), act(pixels))
    assert act.memory is None


def test_only_those_that_are_asked_about_go_on(env, policy):
    act = deterministic(policy)
    features = policy.encode(env.reset(seed=0)[0]["pixels"])
    act.on_features(features)
    before = act.memory.copy()
    act.on_features(features, torch.tensor([False, True]))
    assert torch.equal(act.memory.hidden[0], before.hidden[0])
    assert not torch.equal(act.memory.hidden[1], before.hidden[1])


def test_returns_do_not_depend_on_what_was_played_before(env, policy):
    act = deterministic(policy)
    first, again = (evaluate(env, act, 3, seed=5).returns for _ in range(2))
    assert first == pytest.approx(again, rel=1e-6)


def test_the_action_that_was_played_is_remembered_as_minus_one_to_one(env, policy):
    act = deterministic(policy)
    actions = act(env.reset(seed=0)[0]["pixels"])
    np.testing.assert_allclose(act.memory.action.numpy(), actions / 100, rtol=1e-5)


# --- rehearsals -----------------------------------------------------------------------------------------


def test_a_rehearsal_is_the_teacher_on_true_states_with_noise(env, teacher):
    act = Rehearsal(env.unwrapped, teacher, seed=0)
    obs, _ = env.reset(seed=0)
    mean = teacher.act(obs["state"], deterministic=True)
    off = np.array([act(obs["pixels"]) - mean for _ in range(400)])[..., 0]
    assert np.abs(off).max() <= 200 and (off.std(0) > 0).all()
    assert off.std(0) / 100 == pytest.approx(act._level, rel=0.2)
    act._level[:] = 0
    np.testing.assert_allclose(act(obs["pixels"]), mean, rtol=1e-5)
    act.tick(np.array([True, False]))
    assert act._level[0] > 0 and act._level[1] == 0


def test_a_rehearsal_of_the_policy_remembers_what_was_played(env, teacher, policy):
    acting = deterministic(policy)
    act = Rehearsal(env.unwrapped, teacher, seed=0, policy=acting)
    played = act(env.reset(seed=0)[0]["pixels"])
    np.testing.assert_allclose(acting.memory.action.numpy(), played / 100, rtol=1e-5)


# --- a teacher that lives with errors -------------------------------------------------------------------


def test_noise_is_slow_and_as_large_as_asked_for():
    noise = SlowNoise(np.array([1.0, 10.0]), 500, 0.2, 0.0, seed=0)
    zero = {"observation": np.zeros((500, 2), np.float32), "other": 1}
    made = np.array([noise(zero)["observation"] for _ in range(50)])
    assert made.std((0, 1)) == pytest.approx([0.2, 2.0], rel=0.05)
    assert np.corrcoef(made[:-1, :, 0].ravel(), made[1:, :, 0].ravel())[0, 1] == pytest.approx(0.8, abs=0.03)
    noise.renew(np.arange(500) < 250)
    after = noise(zero)["observation"]
    related = [np.corrcoef(made[-1, part, 0], after[part, 0])[0, 1] for part in (slice(250), slice(250, None))]
    assert abs(related[0]) < 0.2 < 0.6 < related[1]


def test_an_offset_stays_for_an_episode():
    noise = SlowNoise(np.array([1.0, 10.0]), 500, 0.0, 0.2, seed=0)
    zero = {"observation": np.zeros((500, 2), np.float32)}
    first = noise(zero)["observation"]
    assert first.std(0) == pytest.approx([0.2, 2.0], rel=0.1)
    assert np.array_equal(noise(zero)["observation"], first)
    noise.renew(ended := np.arange(500) < 250)
    after = noise(zero)["observation"]
    assert np.array_equal(after[~ended], first[~ended])
    assert abs(np.corrcoef(first[ended, 0], after[ended, 0])[0, 1]) < 0.2


@pytest.mark.parametrize("wrong", [{"noise": 0.3}, {"offset": 0.3}])
def test_the_actor_sees_noise_and_the_critics_the_truth(wrong):
    teacher = StateSAC(**SIZES, **wrong)
    made = teacher.observation_noise(1000, 0)({"observation": np.zeros((1000, 2), np.float32)})["observation"]
    assert made.std(0) == pytest.approx([0.3, 0.3], rel=0.1)
    batch = {name: torch.randn(4, 2) for name in ("state", "next_state", "observation", "next_observation")}
    seen = teacher.standardised(batch)
    assert torch.equal(seen["observation"], teacher.actor.encoder(batch["observation"]))
    assert torch.equal(seen["state"], teacher.actor.encoder(batch["state"]))
    assert not torch.equal(seen["state"], seen["observation"])
    plain = StateSAC(**SIZES).standardised(batch)
    assert torch.equal(plain["observation"], plain["state"])


# --- errors of estimates --------------------------------------------------------------------------------


def test_errors_of_readings_and_estimates_are_measured_in_units(env, policy):
    act = deterministic(policy)
    errors = EstimateErrors(act)
    evaluate(env, act, 2, 0, errors)
    found = errors.to_dict()
    assert set(found) == {"readings", "estimates", "lost"} and len(found["readings"]) == 2
    obs, _ = env.reset(seed=0)
    errors = EstimateErrors(act)
    act(obs["pixels"])
    errors(obs)
    read = policy.actor.encoder.predict(torch.from_numpy(obs["pixels"])).detach().numpy()
    assert errors.to_dict()["readings"] == pytest.approx(np.abs(read - obs["state"]).mean(0).tolist(), abs=1e-3)


def test_a_state_that_is_lost_is_told_where_no_true_state_is_known(env, policy, caplog):
    act = deterministic(policy)
    assert EstimateErrors(act).to_dict() == {}
    evaluate(env, act, 1, 0)
    assert EstimateErrors(act).to_dict() == {"lost": round(act.lost, 4)}
    warn_if_lost(None, "here")
    warn_if_lost(MUCH_LOST, "here")
    assert not caplog.messages
    warn_if_lost(0.5, "here")
    assert caplog.messages[0].startswith("here: the policy loses the state in 50 % of its steps")


def test_recorded_errors_are_played_in_order_times_one_factor_an_episode():
    episodes = [np.arange(1.0, 6)[:, None] * [1, 10], np.arange(100.0, 260)[:, None] * [1, 10]]
    noise, nothing = RecordedErrors(episodes, 3, seed=0), {"observation": np.zeros((3, 2), np.float32)}
    played = np.stack([noise(nothing)["observation"] for _ in range(400)])
    np.testing.assert_allclose(played[..., 1], 10 * played[..., 0], rtol=1e-5)  # components stay together
    factors = noise._factor.copy()
    assert ((factors >= 0) & (factors <= 2)).all() and len(set(factors)) == 3
    raw = played[..., 0] / factors
    known = np.array([0, *episodes[0][:, 0], *episodes[1][:, 0]])
    assert np.abs(raw[..., None] - known).min(-1).max() < 1e-3, "nothing but what was recorded, and none after an end"
    in_order = np.isclose(np.diff(raw, axis=0), 1, atol=1e-3).mean()
    assert 0.75 < in_order < 0.97, "stretches, and jumps between them"
    noise.renew(np.array([True, False, False]))
    assert (noise._factor == factors).tolist() == [False, True, True]


@pytest.mark.parametrize("loses_it", [False, True])
def test_errors_of_estimates_are_what_the_policy_lives_with_while_it_acts(tmp_path, env, policy, loses_it):
    if loses_it:
        policy.filter.usual_correction.fill_(1e-4)
    act, (obs, _) = deterministic(policy), env.reset(seed=3)
    scale = [p.numpy() for p in (policy.actor.encoder.std, policy.actor.encoder.mean)]
    frames, states, actions, lived = [], [], [], []
    for _ in range(6):
        actions.append(act(obs["pixels"])[0])
        frames.append(obs["pixels"][0, -1]), states.append(obs["state"][0])
        lived.append(act.estimates[0].numpy() * scale[0] + scale[1] - obs["state"][0])
        obs, *_ = env.step(np.stack([actions[-1], actions[-1]]))
    seen = {"pixels": np.stack([*frames, obs["pixels"][0, -1]]), "state": np.stack([*states, obs["state"][0]])}
    write_trajectories(tmp_path / "d.h5", Trajectories((Episode(np.stack(actions), seen),), env.dt))
    (errors,) = errors_of_estimates(policy, [tmp_path / "d.h5"])
    np.testing.assert_allclose(errors[:6], lived, atol=2e-4)
    assert (act.lost > 0) == loses_it


# --- a run ----------------------------------------------------------------------------------------------

ON_ESTIMATES = TINY | {
    "teacher.steps": 16, "teacher.adapt": 12, "teacher.dagger": 0, "teacher.rehearse": 64, "teacher.noise": 0.1,
    "teacher.harden": 8, "teacher.rounds": 2, "policy.memory": 8, "filter.stretch": 10, "labels.members": 8,
    "labels.lag": 2, "schedule.grounding_steps": 1, "schedule.source_policy": 0,
    **{f"schedule.{part}.{name}": n for part in ("pretrain", "finetune")
       for name, n in (("policy", 0), ("rehearsed", 4), ("filter", 6))},
    "threads": 1, "side_by_side": "false",
}  # fmt: skip


def options(config, run, values):
    return ["--config", f"configs/{config}.yaml", "--run_dir", str(run), *(f"--{k}={v}" for k, v in values.items())]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "estimates"
    assert main(["fit", *options("pendulum_quick", folder, ON_ESTIMATES)]) == 0
    return folder


def test_a_run_leaves_rehearsals_with_states_and_a_policy_with_a_filter(run):
    from datamodules import read_trajectories
    from idapt_pl.run import Run

    for part in ("teacher", "policy"):
        data = read_trajectories(run / f"step_00/rehearsal_{part}.h5")
        assert data.total_steps == 32 and all("state" in e.observations for e in data)
    loaded = Run.open(run).load_policy(run / "step_01/policy/final.ckpt")
    assert loaded.filter is not None and (loaded.filter.usual_correction < 20).all()
    episodes = read_episodes(loaded, [run / "step_01/rehearsal_policy.h5"])
    assert all(e.readings.shape == e.states.shape and len(e.actions) == len(e.states) for e in episodes)
    assert all((e.actions[0] == 0).all() and np.abs(e.actions).max() <= 1 for e in episodes)


def test_a_run_hardens_every_teacher_that_is_new_and_rehearses_with_it(run):
    def heads(step, *stages):
        files = (run / f"step_{step:02d}/{name}/final.ckpt" for name in stages)
        return [torch.load(file, weights_only=True)["state_dict"]["actor.head.2.weight"] for file in files]

    soft, hard, acting = heads(0, "source_teacher", "hardened_teacher", "policy")
    assert not torch.equal(soft, hard) and torch.equal(hard, acting)
    adapted, again, acting = heads(1, "teacher", "hardened_teacher", "policy")  # F is new, and so is its teacher
    assert not torch.equal(adapted, again) and torch.equal(again, acting)
    assert (run / "step_01/trial_rehearsal.h5").exists()


def test_a_run_rehearses_in_rounds_with_the_last_teacher_of_a_step(run):
    rounds = {path.stem for path in run.glob("step_*/*rehearsal_policy_2.h5")}
    assert rounds == {"hardened_rehearsal_policy_2"}
    last = torch.load(run / "step_01/hardened_filter_policy_2/final.ckpt", weights_only=True)["state_dict"]
    acting = torch.load(run / "step_01/policy/final.ckpt", weights_only=True)["state_dict"]
    assert all(torch.equal(last[f"policy.{name}"], acting[name]) for name in acting if name.startswith("filter."))
    names = list(read_run_record(run).steps[0].seconds)
    first = names.index("hardened_filter_policy")
    assert names[first + 1 : first + 4] == [f"hardened_{k}_policy_2" for k in ("rehearsal", "estimator", "filter")]


def test_a_run_labels_all_target_recordings_so_far_by_physics(run):
    from datamodules import read_trajectories

    shown = [e for k in (0, 1) for e in read_trajectories(run / f"step_{k:02d}/target.h5")]
    assert not any("state" in e.observations for e in shown), "recordings of the target hold no states"
    labelled = read_trajectories(run / "step_01/labelled.h5")
    assert 0 < labelled.total_steps <= sum(map(len, shown))
    frames = np.concatenate([e.observations["pixels"] for e in labelled])
    known = {frame.tobytes() for e in shown for frame in e.observations["pixels"]}
    assert {frame.tobytes() for frame in frames} <= known
    assert all(np.isfinite(e.observations["state"]).all() for e in labelled)
    tried = json.loads((run / "step_01/reading_errors.json").read_text())
    errors = dict(tried["state_errors"])
    assert "got states by physics" in (run / "report.html").read_text()
    assert len(errors) > 3 and errors[tried["factor"]] <= 1.2 * min(errors.values())


@pytest.mark.slow
def test_a_second_opinion_is_formed_on_a_runs_own_recordings(run):
    """From images of the target and their actions; what is written is what the source is given."""
    from idapt_pl.image_diagnosis.sensor import ImageSensor
    from idapt_pl.run import Run
    from idapt_pl.stages.known_start_search import effects_from_known_starts

    opened, folder = Run.open(run), run / "step_00"
    c = opened.context
    G, pi = opened.load_visual(folder / "visual/final.ckpt"), opened.load_policy(folder / "policy/final.ckpt")
    found = [{"effect": "body_mass", "target": "pole", "parameters": {"mass": 20.0}}]
    sensor = ImageSensor(pi.estimator(G), c.worlds.task, c.worlds.frame_stack)
    files = [folder / "target.h5"], folder / "source.h5"
    made = effects_from_known_starts(c, 0, opened.config.effects, sensor, *files, G, pi, found)
    written = json.loads((folder / "known_start_search.json").read_text())
    assert written["effects"] == made and (written["best"] == made or not made)
    assert [p["after"] for p in written["parameters"]] == [v for e in written["best"] for v in e["parameters"].values()]


@pytest.fixture
def rounds(monkeypatch, teacher, policy):
    """A function that gives who acts in rehearsals, the stages' names and what is learned, with nothing run."""
    stages = "idapt_pl.stages.on_estimates"

    def marked(start, number):
        learned = copy.deepcopy(start)
        learned.number = number
        return learned

    def play(count):
        played, names = [], []

        def learns(add):
            return lambda c, k, name, files, n, pi: names.append(name) or marked(pi, add + len(files))

        monkeypatch.setattr(f"{stages}.rehearse", lambda c, k, name, t, acting, G, F: played.append(acting) or name)
        monkeypatch.setattr(f"{stages}.fit_encoder_on", learns(0))
        monkeypatch.setattr(f"{stages}.fit_filter", learns(10))
        lengths = StageLengths(1, 1, 0, rehearsed=4, filter=6)
        learned = in_rehearsals(None, 0, "", lengths, ["labelled"], teacher, policy, None, None, count)
        return [acting and acting.number for acting in played], names, learned.number

    return play


@pytest.mark.parametrize("count", [1, 2, 3])
def test_every_rehearsal_is_of_the_policy_that_learned_in_the_one_before(rounds, count):
    """Not of the one that the stage began with; and each learns from all files so far."""
    played, names, learned = rounds(count)
    assert played == [None, *range(12, 12 + count)] and learned == 12 + count
    assert names[-2:] == (["estimator_policy", "filter_policy"] if count == 1 else
                          [f"estimator_policy_{count}", f"filter_policy_{count}"])  # fmt: skip
    assert len(names) == len(set(names)) == 2 * (count + 1)


def lose(folder, stage):
    """Make a step forget a stage: its folder, or its file and what tells of it."""
    shutil.rmtree(folder / stage, ignore_errors=True)
    for suffix in ("h5", "json"):
        (folder / f"{stage}.{suffix}").unlink(missing_ok=True)


@pytest.mark.parametrize(
    ("step", "prefix", "last"),
    [(0, "source_", ["source_start", "source_policy", "direct_transfer"]), (1, "", ["policy", "evaluation"])],
)
def test_stages_that_are_lost_are_made_again_to_the_bit(step, prefix, last, run, tmp_path):
    again = tmp_path / "again"
    shutil.copytree(run, again)
    folder, policy = again / f"step_{step:02d}", f"{prefix}policy/final.ckpt"
    kept = (folder / policy).read_bytes()
    if not prefix:
        last = [*last, "labelled", "reading_errors"]
    for part in ("teacher", "policy"):
        for stage in ("rehearsal", "estimator", "filter"):
            lose(folder, f"{prefix}{stage}_{part}")
    for stage in last:
        lose(folder, stage)
    assert main(["fit", "--config", str(again / "config.yaml")]) == 0
    assert (folder / policy).read_bytes() == kept


def test_rehearsals_cost_no_target_interactions(run):
    ledger = json.loads((run / "ledger.json").read_text())["entries"]
    assert sum(e["count"] for e in ledger if e["purpose"] == "training") == 60 + 60


def test_the_evaluation_says_how_wrong_the_policy_is_about_the_state(run):
    result = json.loads((run / "step_01/evaluation.json").read_text())
    for where in ("target", "grounded"):
        assert set(result[where]["state_errors"]) == {"readings", "estimates", "lost"}
    page = (run / "report.html").read_text()
    assert "after the filter over time" in page and "lost the state" in page


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"policy.memory": 0}, "a filter learns in rehearsals"),
        ({"teacher.rehearse": 0, "teacher.harden": 0, "teacher.dagger": 16}, "a filter learns in rehearsals"),
        ({"teacher.rehearse": 0, "teacher.dagger": 16}, "errors are measured in rehearsals"),
        ({"teacher.dagger": 16}, "one of"),
        ({"schedule.pretrain.policy": 12}, "SAC does not go on"),
        ({"schedule.pretrain.filter": 0}, "schedule.pretrain.filter is 0"),
        ({"schedule.pretrain.rehearsed": 1}, "schedule.pretrain.rehearsed is 1"),
        ({"filter.dropout": 1}, "filter.dropout"),
        ({"labels.members": 1}, "one guess has no spread"),
        ({"task": "fetch_reach"}, "labels.members needs positions, which the states of fetch_reach do not tell"),
        ({"labels.members": 8, "policy.memory": 0, "teacher.rehearse": 0, "teacher.harden": 0, "teacher.dagger": 16},
         "Give all three"),
        ({"policy.encoder": "learned", "schedule.pretrain.estimator": 0, "schedule.finetune.estimator": 0,
          "feeding.garat_start": "identity"}, "a filter needs readings of states"),
    ],
)  # fmt: skip
def test_settings_that_contradict_each_other_are_told_at_once(changed, message, tmp_path, capsys):
    assert main(["fit", *options("pendulum_quick", tmp_path / "run", ON_ESTIMATES | changed)]) != 0
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run" / "step_00").exists()


def test_policies_can_act_by_physics_and_the_ledger_counts_it(run, tmp_path, capsys):
    copied = tmp_path / "run"
    shutil.copytree(run, copied)
    for folder in copied.glob("step_*/dynamics"):
        shutil.rmtree(folder)  # physics plays actions as they are
    options = ["evaluate", "--run", str(copied), "--episodes", "2", "--seed", "3"]
    assert main([*options, "--physics", "8"]) == 0
    assert "visual grounding, step 0, by 8 simulations" in capsys.readouterr().out
    result = json.loads((copied / "evaluation_2_3_physics8.json").read_text())["policies"]
    assert len(result) == 2, "direct transfer knows no translated images"
    errors = result["IDAPT, grounding step 1, by 8 simulations"]["target"]["state_errors"]
    assert set(errors) == {"readings", "estimates", "lost"} and np.isfinite(errors["estimates"]).all()
    assert main(options) == 0, "an evaluation without physics takes none of its counts away"
    assert main(["ledger", "--run", str(copied)]) == 0
    counted = json.loads((copied / "ledger.json").read_text())["entries"]
    assert sum("by 8 simulations" in e["purpose"] for e in counted) == 2


@pytest.mark.parametrize(("members", "message"), [("1", "one guess has no spread"), ("8", "this run has an F")])
def test_physics_that_cannot_be_is_refused_before_the_target_moves(members, message, run, capsys):
    before = (run / "ledger.json").read_bytes()
    assert main(["evaluate", "--run", str(run), "--episodes", "2", "--physics", members]) != 0
    assert message in capsys.readouterr().err and (run / "ledger.json").read_bytes() == before


def test_target_frames_that_nothing_explains_get_no_label():
    episode = Episode(np.zeros((9, 1), np.float32), {"pixels": np.zeros((10, 4, 4, 3), np.uint8)})
    lost = np.zeros(10, bool)
    lost[4] = True
    states = np.arange(20.0).reshape(10, 2)
    kept = labelled(Trajectories((episode,), 0.1), [Smoothed(states, states, lost)], 1)
    assert [e.observations["state"][:, 0].tolist() for e in kept] == [[0, 2, 4], [12, 14, 16, 18]]
    nothing = labelled(Trajectories((episode,), 0.1), [Smoothed(states, states, np.ones(10, bool))], 1)
    assert len(nothing) == 0


@pytest.mark.parametrize("lost, said", [([20, 20], "control step 20 on"), ([1, 1], "is off")])
def test_much_that_is_lost_is_said_where_nothing_is_done_about_it(lost, said, tmp_path, caplog):
    episode = Episode(np.zeros((50, 1), np.float32), {"pixels": np.zeros((51, 4, 4, 3), np.uint8)})
    data, states = Trajectories((episode, episode), 0.1), np.zeros((51, 2))
    smoothed = [Smoothed(states, states, np.arange(51) >= step) for step in lost]
    told = losses(data, smoothed, labelled(data, smoothed, 1))
    assert told["frames"] == 102 and told["labelled"] == sum(lost) - 2
    c = SimpleNamespace(stages=SimpleNamespace(folder=lambda step: tmp_path))
    warn_of_losses(c, 1, told)
    assert said in caplog.text
    caplog.clear()
    warn_of_losses(c, 0, told)  # in step 0 episodes that begin well are cut, and that is said
    assert bool(caplog.text) == (told["from"] is None)


def test_a_run_can_go_on_where_no_frame_got_a_label(tmp_path):
    shown = Episode(
        np.zeros((3, 1), np.float32), {"pixels": np.zeros((4, 8, 8, 3), np.uint8), "state": np.ones((4, 2))}
    )
    for name, episodes in (("translated", (shown,)), ("labelled", ())):
        write_trajectories(tmp_path / f"{name}.h5", Trajectories(episodes, 0.1))
    both = read_all([tmp_path / "translated.h5", tmp_path / "labelled.h5"], also="state")
    assert len(both) == 1
