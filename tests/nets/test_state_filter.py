"""A filter over time: laws of its memory, what it does where readings are none, and that it learns to see better."""

import numpy as np
import pytest
import torch

from datamodules.stretches import ReadEpisode, StretchDataModule
from idapt_pl.modules import AsymmetricSAC, FilterTraining
from idapt_pl.modules.filter_training import disturbed
from idapt_pl.nets.state_filter import FARTHEST, StateFilter


def trained_like(filter, usual=0.1):
    """As after training: it corrects, and knows by how much."""
    torch.manual_seed(1)
    torch.nn.init.normal_(filter.correction[-1].weight, std=0.1)
    filter.learn_usual_correction(torch.full((50, filter.state_dim), usual))
    return filter


def run(filter, readings, actions):
    """Estimates (t, n, s), step by step."""
    memory, made = filter.begin(readings.shape[1]), []
    for reading, action in zip(readings, actions, strict=True):
        made.append(filter.step(reading, memory))
        memory.action = action
    return torch.stack(made), memory


@pytest.fixture
def sequences():
    return torch.randn(9, 3, 2), torch.rand(9, 3, 1) * 2 - 1


def test_a_new_filter_gives_readings_as_they_are(sequences):
    made, memory = run(StateFilter(2, 1, 8), *sequences)
    torch.testing.assert_close(made, sequences[0])
    assert memory.steps == 9 and not memory.lost.any()


def test_step_by_step_is_as_all_at_once(sequences):
    filter = trained_like(StateFilter(2, 1, 8), usual=10.0)
    made, _ = run(filter, *sequences)
    readings, actions = (x.transpose(0, 1) for x in sequences)
    before = torch.cat([torch.zeros(3, 1, 1), actions[:, :-1]], 1)
    at_once, _ = filter(readings, before, torch.zeros(3, 8))
    torch.testing.assert_close(made.transpose(0, 1), at_once)
    assert (made - sequences[0]).abs().max() > 0.01, "it corrects, else this says nothing"


def test_episodes_do_not_know_of_each_other(sequences):
    filter = trained_like(StateFilter(2, 1, 8), usual=10.0)
    readings, actions = sequences
    together, _ = run(filter, readings, actions)
    alone, _ = run(filter, readings[:, 1:2], actions[:, 1:2])
    torch.testing.assert_close(together[:, 1:2], alone)


def test_forgetting_one_episode_begins_it_anew_and_leaves_the_others(sequences):
    filter = trained_like(StateFilter(2, 1, 8), usual=10.0)
    readings, actions = sequences
    _, memory = run(filter, readings, actions)
    before = memory.copy()
    memory.forget(torch.tensor([False, True, False]))
    fresh = filter.begin(3)
    assert torch.equal(memory.hidden[1], fresh.hidden[1]) and torch.equal(memory.hidden[0], before.hidden[0])
    torch.testing.assert_close(filter.step(readings[0], memory)[1], filter.step(readings[0], fresh)[1])
    memory.put_back(before, torch.ones(3, dtype=torch.bool))
    assert torch.equal(memory.hidden, before.hidden) and torch.equal(memory.action, before.action)


def test_readings_that_are_no_numbers_are_the_last_ones_and_nothing_leaves_that_is_none(sequences):
    filter = trained_like(StateFilter(2, 1, 8), usual=10.0)
    readings, actions = sequences
    broken, held = readings.clone(), readings.clone()
    broken[4, 0], broken[5, 0, 1], broken[6, 1] = torch.nan, torch.inf, 1e30
    held[4, 0], held[5, 0, 1] = readings[3, 0], readings[3, 0, 1]
    made, memory = run(filter, broken, actions)
    assert torch.isfinite(made).all() and torch.isfinite(memory.hidden).all()
    assert made.abs().max() <= FARTHEST
    torch.testing.assert_close(made[:, 0], run(filter, held, actions)[0][:, 0])


def test_where_the_state_is_lost_it_begins_anew_with_the_reading_and_counts(sequences):
    filter = StateFilter(2, 1, 8)
    filter.learn_usual_correction(torch.full((10, 2), 0.01))
    filter.correction[-1].bias.data[:] = 5.0  # far off whatever comes
    readings, actions = sequences
    _, memory = run(filter, readings, actions)
    assert (memory.lost == 9).all()
    fresh = filter.begin(3)
    filter.step(readings[-1], fresh)
    torch.testing.assert_close(memory.hidden, fresh.hidden)


# --- stretches ------------------------------------------------------------------------------------------


def numbered(lengths):
    """Episodes whose readings are (number, time), with actions of the time before."""
    episodes = []
    for number, T in enumerate(lengths):
        at = np.stack([np.full(T + 1, number), np.arange(T + 1)], 1).astype(np.float32)
        episodes.append(ReadEpisode(at, at[:, 1:] - 1, at))
    return episodes


def test_stretches_stay_within_episodes_and_say_where_they_end():
    data = StretchDataModule(numbered([3, 30, 12]), length=10, batch_size=64, batches=4, seed=0)
    batches = list(data.train_dataloader())
    assert len(batches) == 4
    numbers = set()
    for batch in batches:
        number, time = batch["readings"].unbind(-1)
        assert (number == number[:, :1]).all() and torch.equal(batch["states"], batch["readings"])
        there = batch["there"]
        assert ((time.diff(dim=1) == 1) | ~there[:, 1:]).all()
        assert (there.sum(1) == torch.where(number[:, 0] == 0, 4, 10)).all()
        assert (time[:, 0] == 0).float().mean() > 0.4
        numbers |= set(number[:, 0].tolist())
    assert numbers == {0, 1, 2}
    again = StretchDataModule(numbered([3, 30, 12]), 10, 64, 4, seed=0)
    assert all(
        torch.equal(a["readings"], b["readings"]) for a, b in zip(batches, again.train_dataloader(), strict=True)
    )


def test_disturbances_are_what_they_are_said_to_be():
    still = {"gain": 0.0, "offset": 0.0, "noise": 0.0, "dropout": 0.0}
    readings = torch.randn(2000, 12, 3)
    assert torch.equal(disturbed(readings, still), readings)
    ones = torch.ones(2000, 12, 3)
    for name, spread in (("gain", 0.2), ("offset", 0.3)):
        made = disturbed(ones, still | {name: spread})
        assert (made == made[:, :1]).all() and (made - 1).std() == pytest.approx(spread, rel=0.05)
    assert (disturbed(ones, still | {"noise": 0.1}) - 1).std(1).mean() == pytest.approx(0.1, rel=0.05)
    held = disturbed(readings, still | {"dropout": 0.25})
    repeated = (held[:, 1:] == held[:, :-1]).all(-1)
    assert repeated.float().mean() == pytest.approx(0.25, rel=0.1) and torch.equal(held[:, 0], readings[:, 0])


# --- learning -------------------------------------------------------------------------------------------


def oscillators(n, T, noise, seed):
    """Positions and velocities of driven oscillators, as a noisy sensor of positions reads them."""
    rng = np.random.default_rng(seed)
    episodes = []
    for _ in range(n):
        states, actions = [rng.normal(size=2)], [np.zeros(1)]
        for _ in range(T):
            x, v = states[-1]
            a = rng.uniform(-1, 1, 1)
            v = v + 0.3 * (a[0] - x)
            states.append(np.array([x + 0.3 * v, v]))
            actions.append(a)
        s = np.float32(states)
        read = s + noise * rng.normal(size=s.shape).astype(np.float32)
        read[1:, 1] = np.diff(read[:, 0]) / 0.3  # a velocity as two frames tell it
        episodes.append(ReadEpisode(read, np.float32(actions), s))
    return episodes


def filtering_policy(memory=32):
    return AsymmetricSAC(
        state_dim=2, action_low=[-1.0], action_high=[1.0], image_size=16, frame_stack=2, hidden=(8,),
        encoder="supervised", memory=memory, bf16=False,
    )  # fmt: skip


def mean_error(filter, episodes):
    """Of readings and of estimates, on episodes that it did not learn from."""
    readings, actions, states = (
        torch.from_numpy(np.stack([getattr(e, name) for e in episodes])) for name in ("readings", "actions", "states")
    )
    with torch.no_grad():
        made, _ = filter(readings, actions, torch.zeros(len(readings), filter.hidden))
    return (readings - states)[:, 5:].abs().mean((0, 1)), (made - states)[:, 5:].abs().mean((0, 1))


def fit(noise, trainer, batches=400):
    module = FilterTraining(filtering_policy(), lr=5e-3, gain=0.0, offset=0.0, noise=0.0, dropout=0.0)
    data = StretchDataModule(oscillators(40, 60, noise, seed=0), 30, 16, batches, seed=0)
    trainer(batches).fit(module, datamodule=data)
    return module.policy.filter


def test_it_learns_what_time_and_actions_tell(trainer):
    filter = fit(0.3, trainer)
    of_readings, of_estimates = mean_error(filter, oscillators(20, 60, 0.3, seed=1))
    assert of_estimates[0] < 0.6 * of_readings[0] and of_estimates[1] < 0.35 * of_readings[1]
    assert (filter.usual_correction < 5).all() and (filter.usual_correction > 0.05).all()


def test_exact_readings_are_left_about_as_they_are(trainer):
    episodes = [ReadEpisode(e.states, e.actions, e.states) for e in oscillators(20, 60, 0.0, seed=1)]
    module = FilterTraining(filtering_policy(), lr=2e-3, gain=0.0, offset=0.0, noise=0.0, dropout=0.0)
    trainer(200).fit(module, datamodule=StretchDataModule(episodes, 30, 16, 200, seed=0))
    assert mean_error(module.policy.filter, episodes)[1].max() < 0.02


def test_training_moves_the_filter_alone(trainer):
    policy = filtering_policy()
    before = {k: v.clone() for k, v in policy.state_dict().items()}
    module = FilterTraining(policy)
    data = StretchDataModule(oscillators(4, 30, 0.3, seed=0), 10, 4, 20, seed=0)
    trainer(20).fit(module, datamodule=data)
    moved = {k for k, v in policy.state_dict().items() if not torch.equal(v, before[k])}
    assert moved and all(k.startswith("filter.") for k in moved)


def test_the_filter_of_a_finished_policy_is_in_training_mode_while_it_learns(trainer):
    """Without that there is no gradient on a GPU: cuDNN's GRU has none in evaluation mode."""
    policy = filtering_policy().eval()
    data = StretchDataModule(oscillators(4, 30, 0.3, seed=0), 10, 4, 2, seed=0)
    trainer(2).fit(FilterTraining(policy), datamodule=data)
    assert policy.filter.training and not policy.actor.training


def test_a_filter_needs_readings_of_states():
    with pytest.raises(ValueError, match="encoder is learned"):
        AsymmetricSAC(2, [-1.0], [1.0], image_size=16, memory=8)
