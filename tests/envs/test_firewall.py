"""Training sees the target's images and actions and nothing else, and every step is counted."""

import ast
from pathlib import Path

import h5py
import numpy as np
import pytest

from datamodules import write_trajectories
from idapt_pl.envs import BlindTarget, VectorImageEnv
from idapt_pl.envs.ledger import Ledger
from idapt_pl.files import read_json
from idapt_pl.rl.collect import collect
from idapt_pl.targets import SimulatedTarget
from idapt_pl.worlds import Worlds

ROOT = Path(__file__).parents[2]


@pytest.fixture
def ledger(tmp_path):
    return Ledger(tmp_path / "ledger.json")


@pytest.fixture
def blind(cart, ledger):
    env = BlindTarget(VectorImageEnv(cart, cart.domain("hard"), 2, 16, 2), ledger, 3, "training")
    yield env
    env.close()


def push(pixels):
    return np.full((len(pixels), 1), 100, np.float32)


def test_blind_target_shows_pixels_and_nothing_else_also_at_the_end(blind):
    obs, infos = blind.reset(seed=0)
    assert set(obs) == {"pixels"} and infos == {}
    assert set(blind.observation_space.spaces) == set(blind.single_observation_space.spaces) == {"pixels"}
    ended = False
    for _ in range(12):
        obs, rewards, terminations, truncations, infos = blind.step(push(obs["pixels"]))
        assert set(obs) == {"pixels"} and set(infos) <= {"final_obs", "_final_obs"}
        assert set(infos.get("final_obs", {"pixels"})) == {"pixels"}
        assert np.isnan(rewards).all() and not terminations.any()
        ended |= bool(truncations.any())
    assert ended, "the cart leaves the rail: that the episode ended is visible, why is not"


def test_collected_target_data_have_no_reward_no_state_and_no_reason_for_an_end(blind, tmp_path):
    trajectories = collect(blind, push, 20, 0, "target")
    for e in trajectories:
        assert set(e.observations) == {"pixels"} and e.infos == {}
        assert (e.rewards, e.terminations, e.truncations) == (None, None, None)
    write_trajectories(tmp_path / "target.h5", trajectories)
    found = set()
    with h5py.File(tmp_path / "target.h5") as f:
        f.visit(lambda name: found.add(name.split("/")[-1]))
    assert {n for n in found if not n.startswith("episode_")} == {"actions", "observations", "pixels"}


def test_runs_hand_training_a_blind_target(cart, ledger):
    worlds = Worlds(cart, cart.domain("source"), SimulatedTarget(cart, cart.domain("hard")), ledger, 16, 2)
    env = worlds.blind_target(1)
    assert isinstance(env, BlindTarget) and env.num_envs == 1
    env.close()


def test_every_target_step_of_every_simulation_is_counted(blind, ledger):
    blind.reset(seed=0)
    for _ in range(5):
        blind.step(push(np.zeros(2)))
    ledger.enter(3, "training", 10)
    assert ledger.entries == [{"step": 3, "purpose": "training", "count": 10}]


def test_a_file_that_disagrees_with_what_was_counted_is_an_error(blind, ledger):
    blind.reset(seed=0)
    blind.step(push(np.zeros(2)))
    with pytest.raises(RuntimeError, match=r"2 target interactions were made.*step 3.*has 1"):
        ledger.enter(3, "training", 1)
    assert not ledger.path.exists()


def test_ledger_survives_a_restart_and_repeated_entries_count_once(ledger):
    ledger.enter(0, "training", 100)
    ledger.enter(1, "training", 20)
    again = Ledger(ledger.path)
    again.enter(1, "training", 20)
    assert again.entries == ledger.entries and again.training_total == 120
    assert read_json(ledger.path) == {"training_total": 120, "entries": ledger.entries}


def test_evaluation_and_oracle_are_on_the_ledger_but_not_in_the_methods_total(ledger):
    ledger.enter(0, "training", 100)
    ledger.enter(0, "evaluation", 5000)
    ledger.enter(0, "oracle reference", 7000)
    assert ledger.training_total == 100 and len(ledger.entries) == 3


# --- who may reach the target at all, read from the source ----------------------------------------------

NAMES = {
    "target_domain", "rewarded_target", "blind_target", "BlindTarget", "unwrapped", "target_twin", "posable_twin",
    "with_reward", "make_target", "make_robot", "SimulatedTarget", "OtherTaskTarget", "RobotTarget", "RecordedTarget",
}  # fmt: skip
"""Ways to the target, as identifiers, attributes or strings: what makes it, what shows it, what takes a wrapper off."""

EVALUATION = "evaluation: what the policy earns in the target is told, and nothing is trained on it"
CONFIG = "makes a target as a config describes it, for a run's worlds"
DEFINED = "says what targets are"
MADE_HERE = "makes the target, for evaluation with its reward and for training behind BlindTarget"

REACH_THE_TARGET: dict[tuple[str, str], str] = {
    ("idapt_pl/worlds.py", "target_domain"): MADE_HERE,
    ("idapt_pl/worlds.py", "rewarded_target"): MADE_HERE,
    ("idapt_pl/worlds.py", "blind_target"): MADE_HERE,
    ("idapt_pl/worlds.py", "BlindTarget"): MADE_HERE,
    ("idapt_pl/envs/target_env.py", "BlindTarget"): "defines what training sees",
    ("idapt_pl/envs/__init__.py", "BlindTarget"): "exports it",
    ("idapt_pl/worlds.py", "with_reward"): MADE_HERE,
    ("idapt_pl/worlds.py", "target_twin"): MADE_HERE,
    ("idapt_pl/worlds.py", "posable_twin"): MADE_HERE,
    ("idapt_pl/worlds.py", "SimulatedTarget"): "to say that another target's model is not known",
    ("idapt_pl/targets/target.py", "with_reward"): DEFINED,
    ("idapt_pl/targets/target.py", "posable_twin"): DEFINED,
    ("idapt_pl/targets/target.py", "SimulatedTarget"): DEFINED,
    ("idapt_pl/targets/target.py", "OtherTaskTarget"): DEFINED,
    ("idapt_pl/targets/target.py", "RobotTarget"): DEFINED,
    ("idapt_pl/targets/__init__.py", "make_target"): "exports it",
    ("idapt_pl/targets/__init__.py", "SimulatedTarget"): "exports it",
    ("idapt_pl/targets/__init__.py", "OtherTaskTarget"): "exports it",
    ("idapt_pl/targets/__init__.py", "RobotTarget"): "exports it",
    ("idapt_pl/targets/__init__.py", "RecordedTarget"): "exports it",
    ("idapt_pl/targets/recorded.py", "RecordedTarget"): "defines it: images and actions of files, and nothing else",
    ("idapt_pl/targets/from_config.py", "RecordedTarget"): CONFIG,
    ("idapt_pl/stages/collection.py", "RecordedTarget"): "records images and actions: the method's interactions",
    ("idapt_pl/stages/by_hand.py", "RecordedTarget"): "says where recordings are put, and counts their steps",
    ("idapt_pl/run.py", "RecordedTarget"): "counts its files",
    ("idapt_pl/targets/from_config.py", "make_target"): CONFIG,
    ("idapt_pl/targets/from_config.py", "make_robot"): CONFIG,
    ("idapt_pl/targets/from_config.py", "SimulatedTarget"): CONFIG,
    ("idapt_pl/targets/from_config.py", "OtherTaskTarget"): CONFIG,
    ("idapt_pl/targets/from_config.py", "RobotTarget"): CONFIG,
    ("idapt_pl/targets/from_config.py", ".domain(said)"): CONFIG,
    ("idapt_pl/targets/from_config.py", "unwrapped"): "reads the control period of a robot",
    ("idapt_pl/tasks/gymnasium_task.py", "unwrapped"): "the source's own environment",
    ("idapt_pl/run.py", "make_target"): "opens a run: the only place where a config names its target",
    ("idapt_pl/stages/collection.py", "blind_target"): "records images and actions: the method's interactions",
    ("idapt_pl/evaluation/evaluation.py", "rewarded_target"): EVALUATION,
    ("idapt_pl/evaluation/paired.py", "target_twin"): EVALUATION,
    ("idapt_pl/evaluation/paired.py", "unwrapped"): EVALUATION + "; states are put into its source, not read",
    ("idapt_pl/baselines/correspondence.py", "rewarded_target"): EVALUATION,
    (
        "idapt_pl/rl/exploration.py",
        "unwrapped",
    ): "an expert for task-agnostic data, the paper's ablation, acts on states",
    ("idapt_pl/baselines/oracle.py", "rewarded_target"): "the oracle is trained in the target, as a reference",
    ("idapt_pl/report/gallery.py", ".domains()"): "pictures of all domains, for people",
    ("idapt_pl/report/domain_comparison.py", ".domains()"): "a table of what differs between domains, for people",
    ("idapt_pl/tasks/task.py", ".domains()"): "a task finds its domains by name",
    ("cli/evaluate.py", "rewarded_target"): EVALUATION,
    ("cli/check.py", "RecordedTarget"): "shows a person the first frame of a recording",
    ("cli/check.py", "RobotTarget"): "tells how long a control step took, where it is a robot's",
    ("idapt_pl/targets/recording_check.py", "RecordedTarget"): "looks for black images before a run",
    ("cli/check.py", "blind_target"): "shows a person what source and target show",
    ("cli/gallery.py", "target_domain"): "only its name, beside a picture",
    ("cli/collect.py", "BlindTarget"): "hides states and rewards of a recorded target",
    ("cli/collect.py", ".domain(o.domain)"): "records the domain that a person asks for",
}
"""File and way of each legitimate use, and why it is one. All other code is guarded, new files too."""


def names_used(tree: ast.AST) -> set[str]:
    """Every identifier, attribute and string constant."""
    told = {getattr(node, k, None) for node in ast.walk(tree) for k in ("id", "attr", "name", "asname", "arg", "value")}
    return {name for name in told if isinstance(name, str)}


def ways_to_the_target(path: Path) -> set[str]:
    """What of a file reaches the target.

    Names of ``NAMES``, also as strings and in imports; ``.domain(...)`` of anything but ``"source"``; ``.domains()``;
    either of them by ``getattr``, or taken from a task without being called; and ``.env`` of anything but ``self``,
    which takes a wrapper off.
    """
    tree = ast.parse(path.read_text())
    ways = names_used(tree) & NAMES
    calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr == "env" and ast.unparse(node.value) != "self":
            ways.add(f"{ast.unparse(node.value)}.env")
        if isinstance(node, ast.Attribute) and node.attr in ("domain", "domains") and node not in calls:
            ways |= {ast.unparse(node)} if ast.unparse(node.value).endswith("task") else set()
        if not isinstance(node, ast.Call):
            continue
        called, values = node.func, [*node.args, *(k.value for k in node.keywords)]
        if isinstance(called, ast.Attribute) and called.attr == "domains":
            ways.add(".domains()")
        told = [*map(ast.unparse, values)]
        if isinstance(called, ast.Attribute) and called.attr == "domain" and told != ["'source'"]:
            ways.add(f".domain({', '.join(told)})")
        if isinstance(called, ast.Name) and called.id in ("getattr", "attrgetter"):
            names = {v.value for v in values if isinstance(v, ast.Constant)} & {"domain", "domains", "env"}
            ways |= {f"{called.id} of {name}" for name in names}
    return ways


def guarded_files() -> list[Path]:
    return [f for folder in ("idapt_pl", "cli", "datamodules") for f in sorted((ROOT / folder).rglob("*.py"))]


def test_nothing_reaches_the_target_but_what_is_listed():
    found = {(str(f.relative_to(ROOT)), way) for f in guarded_files() for way in ways_to_the_target(f)}
    assert found - REACH_THE_TARGET.keys() == set(), "training must not reach the target; ask for what it needs"
    assert REACH_THE_TARGET.keys() - found == set(), "not used any more: take it off the list"


def test_the_code_that_trains_is_guarded():
    training = ("stages", "rl", "modules", "nets", "image_diagnosis", "appearance", "diagnosis", "estimation", "envs")
    files = {f.relative_to(ROOT / "idapt_pl").parts[0] for f in guarded_files() if f.is_relative_to(ROOT / "idapt_pl")}
    assert files >= {*training, "grounding.py", "stage.py", "losses.py"}
    listed = {file for file, _ in REACH_THE_TARGET if file.split("/")[1] in training}
    assert listed <= {
        "idapt_pl/envs/target_env.py",
        "idapt_pl/envs/__init__.py",
        "idapt_pl/stages/collection.py",
        "idapt_pl/stages/by_hand.py",
        "idapt_pl/rl/collect.py",
        "idapt_pl/rl/exploration.py",
    }


@pytest.mark.parametrize(
    ("text", "way"),
    [
        ("def f(env): return env.unwrapped.data[0].qpos", "unwrapped"),
        ("def f(env): return getattr(env, 'unwrapped').task", "unwrapped"),
        ("def f(worlds): return worlds.rewarded_target(1)", "rewarded_target"),
        ("def f(worlds): make = worlds.rewarded_target; return make(1)", "rewarded_target"),
        ("from x import rewarded_target as source", "rewarded_target"),
        ("def f(worlds): return worlds.target_domain.compile()", "target_domain"),
        ("def f(worlds): return worlds.target.with_reward(1, worlds.look)", "with_reward"),
        ("def f(worlds): return worlds.target_twin().data[0].qpos", "target_twin"),
        ("def f(target_domain): return target_domain", "target_domain"),
        ("def f(worlds): return vars(worlds)['target_domain']", "target_domain"),
        ("def f(make): return make(target_domain=1)", "target_domain"),
        ("def f(worlds): return worlds.blind_target(0)", "blind_target"),
        ("from idapt_pl.envs.target_env import BlindTarget as Env", "BlindTarget"),
        ("def f(task): return task.domain('hard')", ".domain('hard')"),
        ("def f(task): return task.domain(name='easy')", ".domain('easy')"),
        ("def f(worlds, name): return worlds.task.domain(name)", ".domain(name)"),
        ("def f(task): make = task.domain; return make('hard')", "task.domain"),
        ("def f(worlds): return map(worlds.task.domain, ['hard'])", "worlds.task.domain"),
        ("def f(task): return task.domains()['hard']", ".domains()"),
        ("def f(task): return list(task.domains().values())[2]", ".domains()"),
        ("def f(task): return getattr(task, 'domain')('hard')", "getattr of domain"),
        ("def f(task, name='hard'): return getattr(task, 'domains')()[name]", "getattr of domains"),
        ("def f(blind): return blind.env.step(0)", "blind.env"),
        ("class A:\n    def f(self): return self.blind.env", "self.blind.env"),
        ("class A:\n    def f(self): return self.env.env", "self.env.env"),
    ],
)
def test_planted_ways_to_the_target_are_found(tmp_path, text, way):
    (tmp_path / "bad.py").write_text(text)
    assert way in ways_to_the_target(tmp_path / "bad.py")


def test_what_reaches_the_source_only_is_let_through(tmp_path):
    text = """
class Wrapper:
    def step(self, actions):
        return self.env.step(self.domain.command(self.model, actions))
def f(worlds, task, name):
    target, domain = worlds.grounded(1), task.domain("source")
    return worlds.source(1), worlds.source_domain, getattr(task, name), worlds.task.domain(name="source"), domain
"""
    (tmp_path / "good.py").write_text(text)
    assert ways_to_the_target(tmp_path / "good.py") == set()


def test_what_looks_for_effects_in_images_reads_no_rewards():
    files = sorted((ROOT / "idapt_pl/image_diagnosis").glob("*.py"))
    read = [f.name for f in files if "rewards" in names_used(ast.parse(f.read_text()))]
    assert len(files) > 4 and read == []


def test_a_blind_target_tells_the_control_period_and_nothing_else_of_the_simulation(blind):
    assert blind.dt == blind.unwrapped.dt == pytest.approx(0.02)
    for name in ("task", "domain", "model", "data", "set_state", "show"):
        assert not hasattr(blind, name)
