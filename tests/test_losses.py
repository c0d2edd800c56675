"""Losses and targets against their equations."""

import pytest
import torch
from torch.distributions import Normal, TransformedDistribution
from torch.distributions.transforms import TanhTransform

from idapt_pl.estimation.energy import energy_distance
from idapt_pl.losses import (
    flicker,
    gail_reward,
    generalized_advantage,
    gradient_penalty,
    lsgan,
    patch_nce,
    ppo_clip,
    sac_target,
    smoothed_bce,
    squashed_log_prob,
)


def no(t, n=1):
    return torch.zeros(t, n, dtype=torch.bool)


def column(*values):
    return torch.tensor(values)[:, None]


def test_patch_nce_by_hand_and_only_queries_learn():
    key = torch.eye(3)[None].requires_grad_(True)
    same, other = key.detach().clone().requires_grad_(True), key.detach().roll(1, 1)
    right, wrong = patch_nce(same, key, 0.5), patch_nce(other, key, 0.5)
    e = torch.tensor(2.0).exp()
    torch.testing.assert_close(right, -torch.log(e / (e + 2)))
    torch.testing.assert_close(wrong, -torch.log(1 / (e + 2)))
    right.backward()
    assert key.grad is None and same.grad.abs().sum() > 0


def test_flicker_counts_what_stands_still_and_leaves_out_what_moves():
    source = torch.zeros(1, 2, 3, 2, 2)
    source[0, 1, :, 0, 0] = 1.0  # one pixel of four moves
    translated = torch.zeros_like(source)
    translated[0, 1] = 0.5  # all change by a quarter of the range
    m = torch.tensor(-50 * 3 * 0.25).exp()
    torch.testing.assert_close(flicker(translated, source), 0.25 * (3 + m) / 4)
    assert flicker(source * 0, source) == 0


def test_gae_with_lambda_one_is_discounted_return_minus_value():
    T, n, gamma = 7, 3, 0.9
    rewards, all_values = torch.randn(T, n), torch.randn(T + 1, n)
    advantages = generalized_advantage(rewards, all_values[:-1], all_values[1:], no(T, n), no(T, n), gamma, 1.0)
    for t in range(T):
        discounts = gamma ** torch.arange(T - t)[:, None]
        returns = (discounts * rewards[t:]).sum(0) + gamma ** (T - t) * all_values[-1]
        torch.testing.assert_close(advantages[t], returns - all_values[t])


def test_gae_with_lambda_zero_is_the_one_step_error():
    rewards, values, following = torch.randn(3, 5, 2)
    advantages = generalized_advantage(rewards, values, following, no(5, 2), no(5, 2), 0.9, 0.0)
    torch.testing.assert_close(advantages, rewards + 0.9 * following - values)


def test_gae_by_hand_with_a_cut_and_a_termination():
    # Step 1 was cut (bootstrapped, not carried across), step 2 terminated (neither).
    rewards, values, following = column(1.0, 2.0, 3.0), column(0.5, 1.0, 1.5), column(1.0, 4.0, 9.0)
    terminations, ends = column(False, False, True), column(False, True, True)
    a2 = 3.0 - 1.5
    a1 = 2.0 + 0.5 * 4.0 - 1.0
    a0 = (1.0 + 0.5 * 1.0 - 0.5) + 0.5 * 0.8 * a1
    advantages = generalized_advantage(rewards, values, following, terminations, ends, gamma=0.5, lam=0.8)
    torch.testing.assert_close(advantages, column(a0, a1, a2))


def test_sac_target_by_hand_bootstraps_unless_terminated():
    target = sac_target(
        torch.tensor([1.0, 1.0]), torch.tensor([False, True]), torch.tensor([10.0, 10.0]),
        torch.tensor([-2.0, -2.0]), torch.tensor(0.5), 0.9,
    )  # fmt: skip
    torch.testing.assert_close(target, torch.tensor([1 + 0.9 * (10 + 0.5 * 2), 1.0]))


def test_sac_target_refuses_the_silent_broadcast():
    column_of_q = torch.zeros(4, 1)
    with pytest.raises(Exception, match="next_q"):
        sac_target(
            torch.zeros(4),
            torch.zeros(4, dtype=torch.bool),
            column_of_q,
            torch.zeros(4),
            torch.tensor(0.1),
            0.9,
        )


def test_squashed_log_prob_agrees_with_torch_transformed_distribution():
    normal = Normal(torch.randn(50, 3), torch.rand(50, 3) + 0.1)
    u = normal.sample()
    tanh = TanhTransform(cache_size=1)
    reference = TransformedDistribution(normal, [tanh]).log_prob(tanh(u)).sum(-1)
    torch.testing.assert_close(squashed_log_prob(normal.log_prob(u), u), reference, rtol=1e-4, atol=1e-4)


def test_squashed_log_prob_is_finite_where_tanh_saturates():
    u = torch.tensor([[-30.0], [30.0]])
    assert torch.isfinite(squashed_log_prob(Normal(0.0, 10.0).log_prob(u), u)).all()


def test_gail_reward_is_minus_log_sigmoid_and_larger_the_less_it_looks_like_the_agent():
    logits = torch.tensor([-3.0, 0.0, 3.0])
    rewards = gail_reward(logits)
    torch.testing.assert_close(rewards, -torch.sigmoid(logits).log())
    assert (rewards.diff() < 0).all()


@pytest.mark.parametrize(("norm", "penalty"), [(0.5, 0.0), (1.0, 0.0), (3.0, 4.0)])
def test_gradient_penalty_of_a_linear_discriminator_is_the_square_of_its_excess_slope(norm, penalty):
    w = torch.tensor([3.0, 4.0]) / 5 * norm
    torch.testing.assert_close(
        gradient_penalty(lambda x: x @ w[:, None], torch.randn(9, 2), torch.randn(9, 2)),
        torch.tensor(penalty), atol=1e-5, rtol=1e-5,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("ratio", "advantage", "loss"), [(1.5, 1.0, -1.2), (0.5, 1.0, -0.5), (1.5, -1.0, 1.5), (0.5, -1.0, 0.8)]
)
def test_ppo_clips_only_what_would_gain_too_much(ratio, advantage, loss):
    value = ppo_clip(torch.tensor([ratio]).log(), torch.zeros(1), torch.tensor([advantage]), 0.2)
    torch.testing.assert_close(value, torch.tensor(loss))


def test_gan_losses_are_least_at_their_labels():
    assert lsgan(torch.ones(2, 3), True) == 0 and lsgan(torch.zeros(2, 3), False) == 0
    assert lsgan(torch.zeros(2, 3), True) == 1
    logits = torch.linspace(-5, 5, 1001)
    best = logits[torch.stack([smoothed_bce(x[None], True) for x in logits]).argmin()]
    torch.testing.assert_close(torch.sigmoid(best), torch.tensor(0.9), atol=2e-3, rtol=0)


def test_energy_distance_is_near_zero_for_one_distribution_and_large_for_two():
    x, y = torch.randn(400, 3), torch.randn(400, 3)
    assert abs(energy_distance(x, y)) < 0.05
    assert energy_distance(x, y + 2.0) > 1.0
    assert energy_distance(x, 3.0 * y) > 0.5
