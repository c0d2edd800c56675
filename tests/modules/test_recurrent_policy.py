"""Recurrent SAC: stretches are of one simulation, ends cut them, memories act as in training, and it learns."""

from contextlib import closing

import numpy as np
import pytest
import torch

from datamodules import ReplayBuffer, ReplayDataModule
from datamodules.replay import TRANSITION
from idapt_pl.envs import VectorImageEnv
from idapt_pl.modules import RecurrentSAC
from idapt_pl.modules.recurrent_policy import REMEMBERED, counting
from idapt_pl.rl.policy import Acting
from idapt_pl.rl.recurrent_experience import RecurrentExperience


def policy(encoder="learned", **kwargs):
    sizes = {"state_dim": 2, "action_low": [-100.0], "action_high": [100.0], "hidden": (16,)}
    return RecurrentSAC(
        **sizes, image_size=16, frame_stack=2, bf16=False, recurrent=8, sequence=5, encoder=encoder, **kwargs
    )


@pytest.fixture
def env(cart):
    with closing(VectorImageEnv(cart, cart.domain("source"), 2, 16, 2)) as env:
        yield env


def filled(env, pi, steps=40, random=False, capacity=60):
    buffer, act = ReplayBuffer(capacity, 0), RecurrentExperience(env, pi, 0, random)
    for _ in range(steps):
        buffer.add(act())
    return buffer, act


def test_stretches_are_of_one_simulation_in_order_also_round_the_end_of_the_buffer():
    buffer, simulations = ReplayBuffer(12, 0), 3
    for t in range(11):
        buffer.add({"t": np.full(simulations, t), "i": np.arange(simulations)})
        if t < 3:
            continue
        found = buffer.sample_stretches(200, length=3, simulations=simulations)
        assert (found["i"] == found["i"][:, :1]).all() and (found["t"].diff(dim=1) == 1).all()
        assert (
            found["t"].min() == max(0, t - 3) and found["t"].max() == t and set(found["i"][:, 0].tolist()) == {0, 1, 2}
        )


@pytest.mark.parametrize("capacity", [12, 13])
def test_stretches_that_cannot_be_drawn_are_refused(capacity):
    buffer = ReplayBuffer(capacity, 0)
    buffer.add({"t": np.zeros(3)})
    with pytest.raises(ValueError, match="cannot be drawn"):
        buffer.sample_stretches(1, length=2, simulations=3)


def test_what_comes_after_an_end_does_not_count():
    ended = torch.tensor([[False, False, False], [False, True, False], [True, False, True]])
    assert counting(ended).reshape(3, 3).tolist() == [[1, 1, 1], [1, 1, 0], [1, 0, 0]]


@pytest.mark.parametrize("encoder", ["learned", "supervised"])
def test_what_training_sees_of_a_stretch_is_what_acting_saw(env, encoder):
    """From the memory kept at its beginning, the LSTM comes to the memories kept at every later transition."""
    pi = policy(encoder)
    if encoder == "learned":
        pi.features = lambda seen: pi.actor.encoder.encode(seen)  # without random crops
    buffer, _ = filled(env, pi)
    batch = buffer.sample_stretches(32, length=5, simulations=2)
    counts = counting(batch["ended"]).reshape(32, 5).bool()
    assert 0.2 < counts.float().mean() < 1, "episodes end in some stretches"
    with torch.no_grad():
        for sees, name in ((pi.actor_sees(batch), "actor_memory"), (pi.critic_sees(batch, pi.critic), "critic_memory")):
            outputs, kept = sees[:, :-1, -8:], batch[name][..., :8]
            torch.testing.assert_close(outputs[:, :-1][counts[:, 1:]], kept[:, 1:][counts[:, 1:]], atol=1e-5, rtol=1e-4)


def test_episodes_begin_with_no_memory(env):
    buffer, _ = filled(env, policy())
    everything = buffer.sample_stretches(300, length=2, simulations=2)
    ended = everything["ended"][:, 0]
    assert ended.any() and (~ended).any()
    for name in ("actor_memory", "critic_memory", "before"):
        after = everything[name][:, 1].abs().sum(-1)
        assert (after[ended] == 0).all() and (after[~ended] > 0).all()


def test_what_happened_before_changes_what_it_does_and_a_new_episode_forgets(env):
    pi = policy()
    for p in pi.actor.recurrence.lstm.parameters():
        torch.nn.init.normal_(p)
    obs, _ = env.reset(seed=0)
    other = np.zeros_like(obs["pixels"])
    act = Acting(pi, deterministic=True)
    first = act(obs["pixels"])
    act(other)
    assert not np.allclose(act(obs["pixels"]), first)
    act.tick(np.array([True, False]))
    again = act(obs["pixels"])
    assert np.allclose(again[0], first[0]) and not np.allclose(again[1], first[1])
    assert act.lost is None


@pytest.mark.parametrize("encoder", ["learned", "supervised"])
def test_critics_learn_and_everything_that_should_move_moves(env, trainer, encoder):
    pi = policy(encoder, lr=3e-3, estimator_updates=0)
    buffer, act = filled(env, pi, random=True)
    before = {k: v.clone() for k, v in pi.state_dict().items()}
    data = ReplayDataModule(act, buffer, 8, 2, 40, names=(*TRANSITION, *REMEMBERED), stretch=(5, 2))
    t = trainer(40)
    t.fit(pi, datamodule=data)
    losses = [row["policy/critic_loss"] for row in t.history]
    assert np.isfinite(losses).all() and np.mean(losses[-10:]) < 0.5 * np.mean(losses[:10])
    moved = {k for k, v in pi.state_dict().items() if not torch.equal(v, before[k])}
    for part in ("actor.recurrence.lstm", "actor.head", "critic.recurrence.lstm", "critic.twin", "critic_target"):
        assert any(k.startswith(part) for k in moved), part
    assert any(k.startswith("actor.encoder") for k in moved) == (encoder == "learned")
