"""Targets that are known from recordings alone: made before the run, or by hand while it waits."""

import csv
import json
import re

import numpy as np
import pytest
import yaml
from conftest import tiny_config
from PIL import Image
from test_targets import LAB, written

from cli.fit import GroundingCLI
from cli.main import main
from datamodules import Episode, Trajectories, read_trajectories, write_trajectories
from datamodules.episode_folder import read_episode_folder
from datamodules.trajectories import TrajectoryFileError
from idapt_pl.deployment.play import PlayedPolicy
from idapt_pl.envs import ActionMap
from idapt_pl.rl.transition_distance import grounded_rollouts
from idapt_pl.run import Run
from idapt_pl.stages.by_hand import write_plan
from idapt_pl.stages.collection import on_policy
from idapt_pl.targets import Look, RecordedTarget, make_target
from idapt_pl.tasks import make_task

SOURCE = "gymnasium:InvertedPendulum-v5"
LOOK = Look(image_size=16, frame_stack=2)


def episodes(n=3, T=20, side=(24, 40), nu=1, seed=0):
    rng = np.random.default_rng(seed)
    return [
        Episode(
            rng.uniform(-1, 1, (T, nu)).astype(np.float32),
            {"pixels": rng.integers(0, 256, (T + 1, *side, 3), np.uint8), "state": np.full((T + 1, 4), 7.0)},
            np.full(T, 5.0), np.zeros(T, bool), np.zeros(T, bool),
        )
        for _ in range(n)
    ]  # fmt: skip


def as_folder(folder, episode, ending="png", header="force"):
    folder.mkdir(parents=True)
    for t, frame in enumerate(episode.observations["pixels"]):
        Image.fromarray(frame).save(folder / f"{t:05d}.{ending}")
    rows = [",".join(map(str, row)) for row in episode.actions]
    (folder / "actions.csv").write_text("\n".join([header, *rows] if header else rows) + "\n")
    return folder


@pytest.mark.parametrize("header", ["force", ""])
def test_a_table_from_a_spreadsheet_begins_with_a_mark_of_its_encoding(tmp_path, header):
    (episode,) = episodes(1)
    folder = as_folder(tmp_path / "a", episode, header=header)
    table = folder / "actions.csv"
    table.write_text(table.read_text(), encoding="utf-8-sig")
    np.testing.assert_allclose(read_episode_folder(folder).actions, episode.actions, atol=1e-6)


@pytest.mark.parametrize("header", ["force", ""])
def test_a_folder_of_pictures_and_a_table_is_an_episode(tmp_path, header):
    (episode,) = episodes(1)
    read = read_episode_folder(as_folder(tmp_path / "a", episode, header=header))
    np.testing.assert_array_equal(read.observations["pixels"], episode.observations["pixels"])
    np.testing.assert_allclose(read.actions, episode.actions, atol=1e-6)


def test_pictures_are_in_the_order_of_their_numbers_with_or_without_leading_zeros(tmp_path):
    (episode,) = episodes(1)
    folder = as_folder(tmp_path / "a", episode)
    for t in range(21):
        (folder / f"{t:05d}.png").rename(folder / f"{t}.png")
    read = read_episode_folder(folder)
    np.testing.assert_array_equal(read.observations["pixels"], episode.observations["pixels"])


def test_recordings_are_images_of_the_runs_size_and_the_sources_actions_and_nothing_else(tmp_path):
    write_trajectories(tmp_path / "a.h5", Trajectories(tuple(episodes()), 0.04, ""))
    for i, episode in enumerate(episodes()):
        as_folder(tmp_path / "b" / f"episode_{i}", episode)
    said = {"recordings": [str(tmp_path / "a.h5"), str(tmp_path / "b")], "actions": {"scale": -0.5, "offset": 0.1}}
    (tmp_path / "b/__pycache__").mkdir()  # of a play.py that lies there
    target = make_target(said, make_task(SOURCE))
    file, folder = (target.recording(k, LOOK) for k in (0, 1))
    for got in (file, folder):
        assert (len(got), got.total_steps, got.dt) == (3, 60, 0.04)
        for episode, original in zip(got, episodes(), strict=True):
            assert set(episode.observations) == {"pixels"} and episode.rewards is None
            assert episode.observations["pixels"].shape == (21, 16, 16, 3)
            np.testing.assert_allclose(episode.actions, (original.actions - 0.1) / -0.5, atol=1e-5)
    np.testing.assert_array_equal(file.episodes[2].observations["pixels"], folder.episodes[2].observations["pixels"])
    with pytest.raises(ValueError, match="cannot be played"):
        target.with_reward(1, LOOK)


def broken(tmp_path, what):
    """A recording that is wrong in one way."""
    (episode,) = episodes(1, T=4)
    if what == "rate":
        write_trajectories(tmp_path / "a.h5", Trajectories((episode,), 0.05, ""))
        return tmp_path / "a.h5"
    if what == "no images":
        blind = Episode(episode.actions, {"state": np.zeros((5, 2))})
        write_trajectories(tmp_path / "a.h5", Trajectories((blind,), 0.04, ""))
        return tmp_path / "a.h5"
    if what == "actions":
        write_trajectories(tmp_path / "a.h5", Trajectories(tuple(episodes(1, nu=2)), 0.04, ""))
        return tmp_path / "a.h5"
    folder = as_folder(tmp_path / "b", episode)
    if what == "one without a table":
        for name in ("first", "second"):
            as_folder(tmp_path / "many" / name, episode)
        (tmp_path / "many/second/actions.csv").unlink()
        return tmp_path / "many"
    if what == "other units":
        (folder / "actions.csv").write_text("0.1\n0.2\n400\n0.3\n")
    if what == "picture missing":
        (folder / "00002.png").unlink()
    if what == "picture cut":
        (folder / "00002.png").write_bytes((folder / "00002.png").read_bytes()[:100])
    if what == "picture of another size":
        Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(folder / "00002.png")
    if what == "nan":
        (folder / "actions.csv").write_text("0.1\n0.2\nnan\n0.3\n")
    if what == "ragged":
        (folder / "actions.csv").write_text("0.1\n0.2,3\n0\n0.3\n")
    if what == "no table":
        (folder / "actions.csv").unlink()
    if what == "empty table":
        (folder / "actions.csv").write_text("force\n")
    return folder


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("rate", r"one step every 0\.05 s, the source's are 0\.04 s.*action_repeat"),
        ("no images", "episode 0 has no images"),
        ("actions", "actions of 2 numbers, the source of 1"),
        ("picture missing", "4 pictures and 4 actions; there must be one picture more"),
        ("picture cut", r"00002\.png: cannot be read"),
        ("picture of another size", r"00002\.png: is \(8, 8, 3\), and 00000\.png is \(24, 40, 3\)"),
        ("nan", "action 3 is nan; expected 1 finite numbers"),
        ("ragged", "action 2 is 0.2,3; expected 1 finite numbers"),
        ("no table", "holds no episodes"),
        ("empty table", "has no actions"),
        ("one without a table", r"second: has no actions\.csv, as the other episodes of"),
        ("other units", "action 0 of step 2 is 400 in the source's units, whose range is -3 to 3"),
    ],
)
def test_recordings_that_do_not_suit_are_named(tmp_path, what, message):
    target = make_target({"recordings": [str(broken(tmp_path, what))]}, make_task(SOURCE))
    with pytest.raises(ValueError, match=message):
        target.recording(0, LOOK)


def test_columns_in_another_order_than_their_names_say_are_refused(tmp_path):
    (episode,) = episodes(1, nu=2)
    two = ActionMap.from_config({}, -np.ones(2), np.ones(2), ["turn", "grip"])
    target = RecordedTarget("lab", two, 0.1, files=(tmp_path,))
    for header in ("turn,grip", "speed,grip", ""):
        (read,) = target.episodes(as_folder(tmp_path / f"as{header}", episode, header=header), 16)
        np.testing.assert_allclose(read.actions, episode.actions, atol=1e-6)
    with pytest.raises(TrajectoryFileError, match=r"columns are grip, turn; expected in the order turn, grip"):
        target.episodes(as_folder(tmp_path / "b", episode, header="grip, turn"), 16)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"recordings": []}, "give the name of a domain, or one of|give a file or folder"),
        ({"recordings": [3]}, "give a file or folder for each grounding step"),
        ({"recordings": ["a.h5"], "measure": True}, r"target\.measure: unknown with target\.recordings"),
    ],
)
def test_lists_that_make_no_sense_are_refused(said, message):
    with pytest.raises(ValueError, match=message):
        make_target(said, make_task(SOURCE))


@pytest.mark.parametrize(
    ("path", "message"), [("nowhere.h5", r"nowhere\.h5 is not there"), (__file__, r"neither a trajectory file.*import")]
)
def test_recordings_are_missed_before_anything_trains_but_not_where_the_run_has_them(path, message):
    target = make_target({"recordings": [path]}, make_task(SOURCE))
    for missed in (lambda: target.look_for(LOOK), lambda: target.recording(0, LOOK)):
        with pytest.raises(ValueError, match=message):
            missed()
    target.look_for(LOOK, {0})


def test_a_run_on_recordings_alone(tmp_path, capsys, caplog):
    write_trajectories(tmp_path / "a.h5", Trajectories(tuple(episodes()), 0.04, ""))
    config, run = written(tmp_path, recordings=[str(tmp_path / "a.h5")]), tmp_path / "run"
    command = ["fit", "--config", str(config), "--run_dir", str(run)]
    assert main(command) == 1
    assert "target.recordings has 1, but schedule.grounding_steps 1 needs 2" in capsys.readouterr().err
    assert main([*command, "--schedule.grounding_steps", "0"]) == 0
    summary = json.loads((run / "summary.json").read_text())
    assert (summary["target"], summary["target_interactions"], summary["visual_only"]) == ("recordings", 60, None)
    assert main(["ledger", "--run", str(run)]) == 0

    (tmp_path / "a.h5").rename(tmp_path / "b.h5")  # the run has what it needs of it
    assert main(["report", "--run", str(run)]) == main(["fit", "--config", str(run / "config.yaml")]) == 0
    capsys.readouterr()
    assert main(["evaluate", "--run", str(run)]) == 1
    assert "give --outcomes outcomes.csv" in capsys.readouterr().err

    evaluate, table = ["evaluate", "--run", str(run), "--outcomes", str(tmp_path / "seen.csv")], tmp_path / "seen.csv"
    table.write_text("step,outcome,control_steps\n1,2.5,40\n")
    assert main(evaluate) == 1 and "step is '1'; the run has policies of direct, 0" in capsys.readouterr().err
    table.write_text("step,outcome,control_steps\n0,2.5,40\n")
    with caplog.at_level("INFO"):
        assert main(evaluate) == 0 and "corrected" not in caplog.text, "what is told first corrects nothing"
    table.write_text("step,outcome,control_steps\n0,2.5,40\ndirect,1,20\n0,3.5,41\n")
    capsys.readouterr()
    assert main([*evaluate, "--json"]) == main(["ledger", "--run", str(run), "--json"]) == 0
    told = json.JSONDecoder().raw_decode(capsys.readouterr().out)[0]["policies"]
    assert list(told) == ["direct transfer", "visual grounding, step 0"]
    assert (
        told["visual grounding, step 0"]["target"] | {"std": 0.5, "interactions": 81, "mean": 3.0}
        == (told["visual grounding, step 0"]["target"])
    )
    (run / "ledger.json").unlink()
    assert main(["ledger", "--run", str(run), "--json"]) == 0
    counts = {e["purpose"]: e["count"] for e in json.loads(capsys.readouterr().out)["entries"] if e["step"] < 0}
    assert counts["evaluation of visual grounding, step 0, 2 episodes by hand"] == 81


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_images_and_actions_that_were_imported_find_effects_and_ground_a_policy(tmp_path, capsys):
    """Two recordings without joints, at twice the rate: resampled, then a run with a grounding step and discovery."""
    cart, rng, files = lab_cart(tmp_path), np.random.default_rng(0), []
    mapping = {"dt": 0.02, "images": {"column": "front", "size": 40}, "actuators": {"slide": "u"}}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(mapping))
    for k in range(2):
        parts = []
        for number in range(6):
            frames, actions, over = [cart.reset(seed=10 * k + number)[0]], [], False
            while not over and len(actions) < 20:
                actions.append(rng.uniform(-1, 1))
                frame, _, over, *_ = cart.step(np.array(actions[-1:]))
                frames.append(frame)
            parts.append(tmp_path / f"{k}_{number}.npz")
            np.savez(parts[-1], front=np.repeat(frames, 2, 0)[:-1], u=np.repeat(actions, 2))  # a row each 0.02 s
        files.append(str(tmp_path / f"{k}.h5"))
        imported = ["import", *map(str, parts), "--map", str(tmp_path / "map.yaml"), "--out", files[-1]]
        if not k:
            assert main(imported) == 0
            target = make_target({"recordings": files}, make_task(SOURCE))
            with pytest.raises(ValueError, match=r"or resample: idapt import --period 0\.04"):
                target.recording(0, LOOK)
        assert main([*imported, "--period", "0.04"]) == 0
    run, config = tmp_path / "run", written(tmp_path, recordings=files)
    assert main(["fit", "--config", str(config), "--run_dir", str(run), "--effects.discover", "true"]) == 0
    recorded = [read_trajectories(run / f"step_0{k}/target.h5") for k in (0, 1)]
    assert all(set(e.observations) == {"pixels"} and e.rewards is None for part in recorded for e in part)
    assert json.loads((run / "summary.json").read_text())["target_interactions"] == sum(r.total_steps for r in recorded)
    assert (run / "step_00/effects.json").exists() and (run / "step_01/policy/final.ckpt").exists()
    assert main(["ledger", "--run", str(run)]) == 0


@pytest.mark.parametrize(
    ("target", "cut"), [({"by_hand": "inbox", "name": "my arm"}, False), ({"task": SOURCE}, True), ("hard", True)]
)
def test_a_window_that_cuts_the_source_alone_is_told(tmp_path, target, cut):
    config = tmp_path / "own.yaml"
    config.write_text(yaml.safe_dump(tiny_config(target=target)))

    def told(*options):
        return GroundingCLI([f"--config={config}", f"--run_dir={tmp_path / 'run'}", *options]).run().worlds.views_apart

    assert not told("--view.share=1", "--view.up=0")
    window = told("--view.share=0.64", "--view.up=0.12")
    assert not window if cut else "view {share: 0.64, up: 0.12, right: 0} cuts the source's" in window


@pytest.mark.parametrize("there", [True, False])
def test_what_was_recorded_can_be_looked_at_before_a_run(tmp_path, there):
    said = {"by_hand": str(tmp_path / "inbox")}
    if there:
        as_folder(tmp_path / "inbox/step_00/a", episodes(1)[0])
    out = tmp_path / "seen.png"
    assert main(["check", "--config", str(written(tmp_path, **said)), "--out", str(out)]) == 0
    below = np.asarray(Image.open(out))[128:, :128, :3]  # the first picture, four times as large
    assert (below == 255).all() != there


@pytest.mark.parametrize("horizon", [None, 3])
def test_a_plan_is_what_a_policy_that_keeps_time_plays(tmp_path, horizon):
    """As open-loop replays do: without their ticks they would play one action for ever."""

    class Ramp:
        step = 0

        def __call__(self, pixels):
            return np.array([[0.1 * self.step]], np.float32)

        def tick(self, ended):
            self.step = 0 if ended[0] else self.step + 1

    run = GroundingCLI([f"--config={written(tmp_path, by_hand=str(tmp_path))}", f"--run_dir={tmp_path / 'run'}"]).run()
    write_plan(tmp_path / "plan.csv", run.worlds, Ramp(), 7, horizon)
    (name,), *rows = csv.reader((tmp_path / "plan.csv").open())
    expected = 0.1 * (np.arange(7) % (horizon or 7))
    assert name == "slide" and np.allclose(np.array(rows, float)[:, 0], expected)


def lab_cart(tmp_path):
    module: dict = {}
    exec(LAB, module)
    return module["CartPole"]()


def play_by_hand(cart, folder, act, steps):
    """What a person with a stack of their own would record: an episode of at most so many steps. Returns its length."""
    frames, actions, over = [cart.reset(seed=len(list(folder.parent.glob("*"))))[0]], [], False
    while not over and len(actions) < steps:
        actions.append(act(frames[-1]))
        frame, _, over, *_ = cart.step(np.asarray(actions[-1]))
        frames.append(frame)
    T = len(actions)
    as_folder(folder, Episode(np.array(actions, np.float32).reshape(T, -1), {"pixels": np.array(frames)}))
    return T


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_run_by_hand_from_start_to_end(tmp_path, capsys, monkeypatch):
    """It says what to play and record, waits for it, and goes on; the person knows nothing of this project."""
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    monkeypatch.chdir(tmp_path)
    cart, inbox, run = lab_cart(tmp_path), tmp_path / "inbox", tmp_path / "run"
    config = written(tmp_path, by_hand=str(inbox), name="lab cart")
    command = ["fit", "--config", str(config), "--run_dir", str(run)]

    assert main(command) == 3
    said = capsys.readouterr().err
    assert "grounding step 0 needs 60 control steps of lab cart, 0.04 s each; there are 0." in said
    assert f"idapt fit --config {run / 'config.yaml'}" in said and "slide -3 to 3" in said
    with open(inbox / "step_00/actions_to_play.csv", newline="") as file:
        names, *rows = list(csv.reader(file))
    assert (names, len(rows)) == (["slide"], 60)

    plan = iter(np.array(rows, float))
    taken = play_by_hand(cart, inbox / "step_00/first", lambda frame: next(plan), 20)
    assert main(command) == 3 and f"there are {taken}." in capsys.readouterr().err
    while taken < 60:
        number = len(list((inbox / "step_00").glob("*")))
        taken += play_by_hand(cart, inbox / f"step_00/more_{number:03d}", lambda frame: next(plan), 60 - taken)
    assert main(command) == 3
    said = capsys.readouterr().err
    assert "grounding step 1 needs 60 control steps" in said and "play.py" in said
    recorded = list(read_trajectories(run / "step_00/target.h5"))
    np.testing.assert_allclose(np.concatenate([e.actions for e in recorded]), np.array(rows, float), atol=1e-5)

    policy, taken = PlayedPolicy(inbox / "step_01/policy.onnx"), 0
    assert policy.about["policy"] == "step_00" and "the policy of step 0" in said
    while taken < 60:
        policy.begin()
        number = len(list((inbox / "step_01").glob("*")))
        taken += play_by_hand(cart, inbox / f"step_01/episode_{number:03d}", policy, 60 - taken)
    mark = inbox / "step_01/policy.sha256"
    mine = mark.read_text()
    mark.write_text("of another run")
    assert main(command) == 1 and "not of this run's policy of step 0" in capsys.readouterr().err
    mark.write_text(mine)
    assert main(command) == 0
    summary = json.loads((run / "summary.json").read_text())
    assert (summary["target"], summary["target_interactions"]) == ("lab cart", 120)
    at_home = Run.open(run)
    pi = at_home.load_policy(run / "step_00/policy/final.ckpt")
    assert on_policy(at_home.context, pi)(0).deterministic, "as the file acts, which was played in the target"
    (rolled,) = grounded_rollouts(at_home.worlds, pi, None, None, 3, 1, 0)
    np.testing.assert_allclose(rolled.actions, pi.act(rolled.stacks(rolled.transitions), True), atol=1e-5)
    assert not make_target("hard", make_task("inverted_pendulum")).mean_actions, "where idapt itself plays it samples"
    assert re.search("the target is not measured", (run / "report.html").read_text())
