"""A grounding step that makes things worse is rolled back, by images and actions of the target alone."""

import ast
import json
import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest
import torch
from conftest import ROOT, TINY, numbered_episodes
from torch import nn

from cli.main import main
from datamodules import write_trajectories
from datamodules.on_policy import target_transitions
from datamodules.pieces import EVERY, LONGEST, held_out, pieces
from datamodules.stacks import FrameStacks
from idapt_pl.effects import effect_from_dict
from idapt_pl.envs.ledger import Ledger
from idapt_pl.estimation.energy import energy_distance
from idapt_pl.modules import ActionTransformation
from idapt_pl.rl.collect import collect
from idapt_pl.rl.transition_distance import half_of_episodes, transition_residual
from idapt_pl.stages.policy import fit_grounded_policy
from idapt_pl.stages.rollback import (
    TransitionSample,
    bootstrap_comparison,
    compare_transformations,
    unpredicted_change,
)
from idapt_pl.targets import SimulatedTarget
from idapt_pl.worlds import Worlds

# --- what is held out -----------------------------------------------------------------------------------


def test_pieces_are_episodes_and_parts_of_long_ones_and_never_cross_an_episode():
    lengths = [30, 120, 40, 50]
    data = FrameStacks(numbered_episodes([*lengths, *[30] * 10]), 2)
    piece = pieces(data)
    assert len(piece) == len(data) and (np.diff(piece) >= 0).all() and set(np.diff(piece)) <= {0, 1}
    episodes = [np.unique(piece[data.first == f]) for f in np.unique(data.first)]
    assert [len(p) for p in episodes] == [1, 3, 1, 1, *[1] * 10]
    assert len(np.unique(np.concatenate(episodes))) == sum(map(len, episodes)), "no piece is of two episodes"
    assert np.bincount(piece[data.transitions]).max() <= LONGEST


@pytest.mark.parametrize("lengths", [[1000], [10], [3, 4, 5], [24] * 40])
def test_about_a_fifth_is_held_out_of_recordings_of_any_shape(lengths):
    data = FrameStacks(numbered_episodes(lengths), 2)
    out = held_out(pieces(data)[data.transitions])
    assert 0.1 <= out.mean() <= 0.3
    assert len(np.unique(pieces(data)[data.transitions][out])) >= 2


def test_garat_is_not_given_what_is_held_out_of_the_newest_file(tmp_path):
    for name in ("old", "new"):
        write_trajectories(tmp_path / f"{name}.h5", numbered_episodes([3] * 10, state=False))
    files = [tmp_path / "old.h5", tmp_path / "new.h5"]

    def number(stacks):  # of the episode
        return torch.from_numpy(stacks[:, -1, 0, 0, :1].astype(np.float32))

    def episodes(**options):
        return set(target_transitions(files[-1:], number, 1, **options)["features"].flatten().int().tolist())

    assert episodes() == set(range(1, 11))
    assert episodes(hold_out=True) == set(range(1, 11)) - {EVERY, 2 * EVERY}
    both = target_transitions(files, number, 1, hold_out=True)["features"].flatten()[:30]
    assert set(both.int().tolist()) == set(range(1, 11)), "older files are given whole"


# --- the decision ---------------------------------------------------------------------------------------


def sample(n, shift=0.0, seed=0, piece=10):
    values = torch.randn(n, 3, generator=torch.Generator().manual_seed(seed)) + shift
    return TransitionSample(values, np.arange(n) // piece)


def test_the_distance_is_the_energy_distance_where_every_transition_is_a_piece():
    x, y = sample(40, 0.5, 1, 1), sample(30, 0.0, 2, 1)
    result = bootstrap_comparison(x, x, y, 0)
    assert result.before == pytest.approx(energy_distance(x.values, y.values), abs=1e-4)
    assert result.worse_by == 0.0 and not result.rolled_back


def test_clearly_worse_is_rolled_back_and_better_or_the_same_is_not():
    real = sample(200, 0.0, 1)
    assert bootstrap_comparison(sample(600, 0.0, 2), sample(600, 0.8, 3), real, 0).rolled_back
    assert not bootstrap_comparison(sample(600, 0.8, 3), sample(600, 0.0, 2), real, 0).rolled_back
    assert not bootstrap_comparison(sample(600, 0.1, 4), sample(600, 0.05, 5), real, 0).rolled_back, "slightly better"


def test_chance_alone_seldom_rolls_back():
    """Pieces that go together, as episodes do: nominally 2.5 % of decisions are wrong."""

    def drawn(rng, pieces, size=10):
        values = np.repeat(rng.normal(size=(pieces, 2)), size, 0) + 0.3 * rng.normal(size=(pieces * size, 2))
        return TransitionSample(torch.from_numpy(values).float(), np.arange(pieces * size) // size)

    rng = np.random.default_rng(0)
    wrong = sum(bootstrap_comparison(drawn(rng, 30), drawn(rng, 30), drawn(rng, 8), i).rolled_back for i in range(100))
    assert wrong <= 8


def test_what_actions_do_is_seen_behind_what_follows_from_the_state():
    g = torch.Generator().manual_seed(0)

    def moved(n, gain):
        f, a = torch.randn(n, 1, generator=g), torch.randn(n, 1, generator=g)
        return torch.cat([f, a, 3 * f + gain * a + 0.05 * torch.randn(n, 1, generator=g)], 1)

    real, same, other = moved(400, 0.2), moved(400, 0.2), moved(400, -0.2)
    describe = unpredicted_change(moved(400, 0.2), 1)
    assert describe(real)[:, 2].std() == pytest.approx(1.0, abs=0.15)
    assert energy_distance(other, real) < 0.05, "hidden in the plain transitions"
    assert energy_distance(describe(other), describe(real)) > 0.5
    assert abs(energy_distance(describe(same), describe(real))) < 0.05


# --- in worlds ------------------------------------------------------------------------------------------


class WhereTheCartIs(nn.Module):
    """Features of frames: the box's place in the image and its change since the frame before."""

    features = 2

    def encode(self, pixels):
        red = (pixels[..., 0].float() - pixels[..., 2].float()).clamp(min=0)  # (n, K, H, W)
        along = torch.linspace(-1, 1, red.shape[-1])
        x = (red.sum(-2) * along).sum(-1) / red.sum((-2, -1)).clamp(min=1)
        return torch.stack([x[:, -1], 10 * (x[:, -1] - x[:, -2])], -1)


def make_F(gain=1.0, bias=0.0):
    """F that scales and shifts actions, in units of their half range."""
    F = ActionTransformation(WhereTheCartIs(), [-100.0], [100.0], hidden=(8,), smoothing=1.0, residual_scale=1.0)
    nn.init.zeros_(F.actor[-1].weight)
    F.affine.weight.data[:, -1], F.affine.bias.data[:] = gain - 1, bias
    F.feature_std[:], F.change_std[:] = 0.1, 0.1
    return F.eval()


class Centering:
    """A policy that pushes the box to the middle; it draws from torch's generator, as π does."""

    def encode(self, pixels):
        return WhereTheCartIs().encode(torch.from_numpy(pixels))

    def begin(self, n):
        return None

    def remembering(self, features, memory):
        return features

    def actor(self, features, deterministic):
        x, rate = features.T
        return ((100 * (-3 * x - 0.3 * rate + 0.3 * torch.randn(len(x))).clamp(-1, 1))[:, None],)

    def act(self, pixels):
        return self.actor(self.encode(pixels), False)[0].numpy()


@pytest.fixture
def worlds(cart, tmp_path, monkeypatch):
    """A source, and a target in which commands do half as much, that nobody may make again."""
    half = effect_from_dict({"effect": "actuator_gain", "target": "push", "parameters": {"gain": 0.5}})
    source = cart.domain("source")
    worlds = Worlds(
        cart, source, SimulatedTarget(cart, source.with_effects(half)), Ledger(tmp_path / "ledger.json"), 64, 2
    )
    with_target = worlds.blind_target(1)
    write_trajectories(tmp_path / "target.h5", collect(with_target, Centering().act, 1000, 1, ""))
    with_target.close()

    def forbidden(*args):
        raise AssertionError("selection makes no target")

    monkeypatch.setattr(Worlds, "blind_target", forbidden)
    monkeypatch.setattr(Worlds, "rewarded_target", forbidden)
    return worlds


@pytest.fixture
def decide(worlds, tmp_path):
    def decide(F, F_before, target=tmp_path / "target.h5"):
        return compare_transformations(worlds, Centering(), None, F, F_before, target, 3)

    return decide


@pytest.mark.slow
def test_sabotaged_action_transformations_are_rolled_back(decide):
    for sabotaged in (make_F(gain=-0.5), make_F(gain=0.5, bias=0.5)):
        result = decide(sabotaged, make_F(gain=0.5))
        assert result.rolled_back and result.after > result.before, str(result)
        assert "rolled back" in result.sentence


@pytest.mark.slow
def test_the_identity_against_itself_and_an_improvement_are_kept(decide):
    same = decide(make_F(), None)
    assert not same.rolled_back and same.worse_by == 0 and same.ci95[0] < 0 < same.ci95[1]
    better = decide(make_F(gain=0.5), None)
    assert not better.rolled_back and better.after < better.before
    assert not decide(make_F(gain=0.55), make_F(gain=0.6)).rolled_back, "a little better"
    assert "kept" in better.sentence


@pytest.mark.slow
def test_the_residual_is_the_same_for_the_identity_and_falls_beyond_its_spread_for_what_is_right(worlds, tmp_path):
    def measured(F):
        return transition_residual(worlds, Centering(), None, F, [tmp_path / "target.h5"], 3)

    same, right = measured(make_F()), measured(make_F(gain=0.5))
    assert same["before"] == same["after"] and same["before_std"] == same["after_std"], str(same)
    assert right["after"] + 2 * right["after_std"] < right["before"] - 2 * right["before_std"], str(right)


# --- the firewall ---------------------------------------------------------------------------------------


def test_rewards_and_states_in_a_target_file_would_change_nothing(decide, tmp_path):
    poisoned = tmp_path / "poisoned.h5"
    shutil.copy(tmp_path / "target.h5", poisoned)
    with h5py.File(poisoned, "a") as f:
        for episode in f.values():
            T = len(episode["actions"])
            episode["rewards"], episode["observations/state"] = np.full(T, 1e9), np.full((T + 1, 2), 1e9)
    assert decide(make_F(0.5), None, poisoned) == decide(make_F(0.5), None)


@pytest.mark.parametrize("name", ["stages/rollback", "rl/transition_distance"])
def test_the_code_that_selects_names_no_reward_no_state_and_no_evaluation(name):
    tree = ast.parse((ROOT / "idapt_pl" / f"{name}.py").read_text())
    docstrings = {
        node.body[0].value for node in ast.walk(tree) if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and isinstance(node.body[0], ast.Expr)
    }  # fmt: skip
    used = set()
    for node in ast.walk(tree):
        used |= {getattr(node, k) for k in ("id", "attr", "name", "arg", "module") if hasattr(node, k)}
        if isinstance(node, ast.Constant) and node not in docstrings:
            used.add(node.value)
    words = {w for text in used if isinstance(text, str) for w in text.split(".")}
    assert {"grounded_rollouts", "standardised_transitions"} <= words, "the check sees nothing"
    forbidden = {"rewarded_target", "blind_target", "rewards", "state", "evaluate", "evaluation", "target_return"}
    assert not words & forbidden


# --- in Algorithm 1 -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_step_that_is_rolled_back_trains_without_its_f_and_a_resumed_run_repeats_the_decision(
    tiny_args, finished_run, tmp_path, monkeypatch
):
    run, seen, policies, trained_with = tmp_path / "run", [], [], []

    def worse(worlds, pi, G, F, F_before, target, seed):
        seen.append((F_before, target))
        policies.append(pi)
        real = compare_transformations(worlds, pi, G, F, F_before, target, seed)
        return replace(real, rolled_back=len(seen) == 1)  # the first step is, the second is not

    def watched(context, step, lengths, G, F, *others):
        trained_with.append(F is not None)
        return fit_grounded_policy(context, step, lengths, G, F, *others)

    monkeypatch.setattr("idapt_pl.grounding.fit_grounded_policy", watched)
    monkeypatch.setattr("idapt_pl.stages.rollback.compare_transformations", worse)
    shutil.copytree(finished_run / "step_00", run / "step_00")
    assert main(["fit", *tiny_args(run, schedule__rollback="true")]) == 0
    assert trained_with == [False, False, True]
    assert (run / "step_01/dynamics/final.ckpt").exists(), "what was tried is kept for a look at it"
    assert [p.parent.name for _, p in seen] == ["step_01", "step_02"]
    assert [f for f, _ in seen] == [None, None], "the second F is compared with what was gone back to"
    for k, policy in enumerate(policies):  # that made the recordings, before the step's estimator changed its encoder
        kept = torch.load(run / f"step_0{k}/policy/final.ckpt", weights_only=True)["state_dict"]
        assert all(torch.equal(v, kept[name]) for name, v in policy.state_dict().items())
    summary = json.loads((run / "summary.json").read_text())
    assert summary["rolled_back"] == [1] and len(summary["grounded"]) == TINY["schedule.grounding_steps"]

    shutil.rmtree(run / "step_02")
    before = (run / "step_01/selection.json").read_bytes()
    assert main(["fit", *tiny_args(run, schedule__rollback="true")]) == 0
    assert (run / "step_01/selection.json").read_bytes() == before
    assert [p.parent.name for _, p in seen] == ["step_01", "step_02", "step_02"]


def test_without_rollback_nothing_is_compared(finished_run):
    assert not list(finished_run.glob("step_*/selection.json"))
    assert json.loads((finished_run / "summary.json").read_text())["rolled_back"] == []


@pytest.mark.parametrize("lengths", [[1000], [3, 5, 4], [2, 2]])
def test_the_floor_has_two_halves_to_compare(lengths):
    """Also where a policy never falls, so that there is one episode."""
    mask = half_of_episodes(lengths)
    assert len(mask) == sum(lengths) and 0.25 < mask.mean() < 0.75
