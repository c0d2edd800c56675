"""SAC's gradients as they are written out are those of autograd, and so is what an update leaves."""

import copy

import pytest
import torch
import torch.nn.functional as nnf

from idapt_pl.modules import AsymmetricSAC, StateSAC
from idapt_pl.modules.sac_gradients import actor_gradients, critic_gradients, lower_value

STATE, ACTION, N = 5, 2, 32


@pytest.fixture
def module():
    torch.manual_seed(0)
    return StateSAC(STATE, [-3.0, 0.0], [1.0, 4.0], hidden=[24, 16], temperature=0.3)


def transitions(updates=None):
    torch.manual_seed(1)
    shape = (N,) if updates is None else (updates, N)
    low, high = torch.tensor([-3.0, 0.0]), torch.tensor([1.0, 4.0])
    seen = {k: torch.randn(*shape, STATE) for k in ("observation", "state", "next_observation", "next_state")}
    actions = low + (high - low) * torch.rand(*shape, ACTION)
    return seen | {"actions": actions, "rewards": torch.randn(shape), "terminations": torch.rand(shape) < 0.2}


def test_gradients_of_the_critics_loss(module):
    t, target = transitions(), torch.randn(N)
    q = module.critic(t["state"], t["actions"])
    expected = nnf.mse_loss(q, target.expand_as(q)) * 2
    grads = torch.autograd.grad(expected, list(module.critic.parameters()))
    loss, values = critic_gradients(module.critic, t["state"], t["actions"], target)
    torch.testing.assert_close((loss, values), (expected.detach(), q.detach()))
    for p, wanted in zip(module.critic.parameters(), grads, strict=True):
        torch.testing.assert_close(p.grad, wanted)


@pytest.mark.parametrize("target_entropy", [None, -1.5])
def test_gradients_of_the_actors_loss_and_of_the_temperatures(module, target_entropy):
    t = transitions()
    torch.manual_seed(2)
    action, log_prob = module.actor(t["observation"])
    q, alpha = torch.minimum(*module.critic(t["state"], action)), module.log_alpha.exp()
    expected = (alpha.detach() * log_prob - q).mean()
    of_alpha = 0.0 if target_entropy is None else alpha * (log_prob.detach().mean() + target_entropy)
    leaves = [*module.actor.head.parameters(), module.log_alpha]
    grads = torch.autograd.grad(expected - of_alpha, leaves, allow_unused=True)
    torch.manual_seed(2)  # the same noise
    found = actor_gradients(module.actor, module.critic, module.log_alpha, t["observation"], t["state"], target_entropy)
    torch.testing.assert_close(found, (expected.detach(), log_prob.detach()))
    for p, wanted in zip(leaves, grads, strict=True):
        assert (p.grad is None) == (wanted is None)
        if wanted is not None:
            torch.testing.assert_close(p.grad, wanted)
    assert all(p.grad is None for p in module.critic.parameters()), "the critics judge, and learn nothing"


def test_the_lower_value_and_its_slope_are_of_the_critic_that_says_it(module):
    x = torch.randn(N, STATE + ACTION, requires_grad=True)
    both = torch.cat([net(x) for net in module.critic.nets], 1)
    assert 0 < (both[:, 0] < both[:, 1]).sum() < N, "either is lower somewhere"
    wanted = torch.autograd.grad(both.min(1).values.sum(), x)[0][:, STATE:]
    with torch.no_grad():
        q, by_action = lower_value(module.critic, x, ACTION)
    torch.testing.assert_close((q, by_action), (both.min(1).values.detach(), wanted))


class ManyUpdates:
    """Stands for a Trainer: nets of one device in float32, and so many batches."""

    world_size, precision, max_epochs, num_training_batches = 1, "32-true", 1, 10**9


def updated(module, updates, plain, monkeypatch):
    """Critic, head and temperature after updates with written-out gradients (``plain``) or autograd's."""
    module = copy.deepcopy(module)
    monkeypatch.setattr(type(module), "plain", plain)
    monkeypatch.setattr(type(module), "manual_backward", lambda self, loss, **k: loss.backward(**k))
    module._trainer = ManyUpdates()
    optimizers, _ = module.configure_optimizers()
    monkeypatch.setattr(type(module), "optimizers", lambda self: optimizers)
    torch.manual_seed(3)
    module.update({"transitions": transitions(updates)})
    return module.state_dict()


def image_policy(encoder):
    return AsymmetricSAC(STATE, [-3.0, 0.0], [1.0, 4.0], image_size=24, hidden=[24, 16], encoder=encoder, actor_every=2)


@pytest.mark.parametrize("make", [None, lambda: image_policy("supervised")], ids=["states", "estimates"])
def test_updates_leave_what_autograd_leaves(module, make, monkeypatch):
    module = module if make is None else make()
    before = module.state_dict()
    written, theirs = (updated(module, 20, plain, monkeypatch) for plain in (True, False))
    assert any(not torch.equal(before[k], v) for k, v in written.items())
    for name, value in theirs.items():
        torch.testing.assert_close(written[name], value, rtol=2e-3, atol=2e-4, msg=name)


class LearnedFeatures(StateSAC):
    """Somebody's SAC whose encoder learns."""

    def __init__(self):
        super().__init__(STATE, [-3.0, 0.0], [1.0, 4.0], hidden=[24, 16])
        self.actor.encoder.layer = torch.nn.Linear(STATE, STATE)


@pytest.mark.parametrize("make", [lambda: image_policy("learned"), LearnedFeatures], ids=["images", "somebody's"])
def test_an_encoder_that_the_actors_loss_trains_keeps_autograds_gradients(make):
    module = make()
    module._trainer = ManyUpdates()
    assert module.plain and not module.heads_alone


def test_heads_alone_are_those_of_states_and_of_estimates(module):
    for one in (module, image_policy("supervised")):
        one._trainer = ManyUpdates()
        assert one.heads_alone
