"""Losses and targets as pure functions, each with its equation and source."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as nnf
from jaxtyping import Bool, Float
from torch import Tensor


def lsgan(logits: Float[Tensor, ...], real: bool) -> Float[Tensor, ""]:
    """Least-squares GAN, E[(D(x) - y)²], y = 1 for real (Mao et al. 2017; Zhu et al. 2017, sec. 4)."""
    return (logits - float(real)).square().mean()


def smoothed_bce(logits: Float[Tensor, ...], real: bool) -> Float[Tensor, ""]:
    """Cross-entropy of the mean logit against 0.9 (real) or 0.1 (fake), as in the IDAPT authors' code."""
    label = logits.new_tensor(0.9 if real else 0.1)
    return nnf.binary_cross_entropy_with_logits(logits.mean(), label)


GAN_LOSSES: dict[str, Callable[[Tensor, bool], Tensor]] = {"lsgan": lsgan, "bce": smoothed_bce}


def patch_nce(
    query: Float[Tensor, "b p d"], key: Float[Tensor, "b p d"], temperature: float = 0.07
) -> Float[Tensor, ""]:
    """Cross-entropy of telling a patch's own counterpart from the image's other patches (Park et al. 2020, eq. 3).

    Args:
        query: unit features of the translated image's patches.
        key: of the source image's, at the same places; no gradient flows into them.
        temperature: τ.
    """
    logits = query @ key.detach().mT / temperature  # (b, p, p)
    own = torch.arange(logits.shape[1], device=logits.device).expand(logits.shape[:2])
    return nnf.cross_entropy(logits.flatten(0, 1).float(), own.flatten())


def flicker(
    translated: Float[Tensor, "b k c h w"], source: Float[Tensor, "b k c h w"], sharpness: float = 50.0
) -> Float[Tensor, ""]:
    """E[m |G(o_t) - G(o_t-1)|], m = exp(-α |o_t - o_t-1|²), images in 0..1: what stands still must stay as it is.

    The temporal loss of Lai et al. 2018, eqs. 4 and 5, without the optical flow: pixels that move are left out (m ≈ 0)
    instead of followed.

    Args:
        translated: frames of G, -1..1, in order of time along the second dimension.
        source: the frames they were made of, -1..1.
        sharpness: α.
    """
    still = torch.exp(-sharpness * (source.diff(dim=1) / 2).square().sum(2, keepdim=True))
    return (still * translated.diff(dim=1) / 2).abs().mean()


def gail_reward(logits: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    """-log D(x) with D = sigmoid(logit) = 1 for the agent (GAIfO, Torabi et al. 2018, alg. 1)."""
    return nnf.softplus(-logits)


def gradient_penalty(
    discriminator: Callable[[Tensor], Tensor], agent: Float[Tensor, "n d"], target: Float[Tensor, "n d"]
) -> Float[Tensor, ""]:
    """E[max(0, |∇D(x)| - 1)²] on lines between the two sets (one-sided; Petzka et al. 2018, eq. 5).

    Args:
        discriminator: D, inputs (n, d) to logits.
        agent: one end of each line.
        target: the other.
    """
    mix = torch.rand(len(agent), 1, device=agent.device)
    x = (mix * agent + (1 - mix) * target).requires_grad_(True)
    (gradient,) = torch.autograd.grad(discriminator(x).sum(), x, create_graph=True)
    return (gradient.norm(dim=-1) - 1).clamp(min=0).square().mean()


def generalized_advantage(
    rewards: Float[Tensor, "t n"],
    values: Float[Tensor, "t n"],
    next_values: Float[Tensor, "t n"],
    terminations: Bool[Tensor, "t n"],
    ends: Bool[Tensor, "t n"],
    gamma: float,
    lam: float,
) -> Float[Tensor, "t n"]:
    """GAE: A_t = δ_t + γλ A_{t+1}, δ_t = r_t + γ V(s_{t+1}) - V(s_t) (Schulman et al. 2016, eq. 16).

    Args:
        rewards: r_t.
        values: V(s_t).
        next_values: V of the true successor, also where an episode was cut there.
        terminations: the task ended: nothing is bootstrapped.
        ends: an episode ended or was cut: nothing is carried across.
        gamma: γ.
        lam: λ.
    """
    delta = rewards + gamma * next_values * ~terminations - values
    advantages = torch.zeros_like(delta)
    carry = torch.zeros_like(delta[0])
    for t in reversed(range(len(delta))):
        carry = delta[t] + gamma * lam * ~ends[t] * carry
        advantages[t] = carry
    return advantages


def ppo_clip(
    log_prob: Float[Tensor, " n"], old_log_prob: Float[Tensor, " n"], advantage: Float[Tensor, " n"], clip: float
) -> Float[Tensor, ""]:
    """-E[min(ρA, clip(ρ, 1-ε, 1+ε)A)] (Schulman et al. 2017, eq. 7).

    Args:
        log_prob: of the actions under the policy that is trained; ρ is its ratio to
        old_log_prob: of the actions under the policy that took them.
        advantage: A.
        clip: ε.
    """
    ratio = (log_prob - old_log_prob).exp()
    return -torch.min(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage).mean()


def sac_target(
    rewards: Float[Tensor, " n"],
    terminations: Bool[Tensor, " n"],
    next_q: Float[Tensor, " n"],
    next_log_prob: Float[Tensor, " n"],
    alpha: Float[Tensor, ""],
    gamma: float,
) -> Float[Tensor, " n"]:
    """R + γ (1 - d)(min Q(s', a') - α log π(a'|o')), d = terminated, not truncated (Haarnoja et al. 2018, eq. 3).

    Args:
        rewards: R.
        terminations: d.
        next_q: min Q(s', a').
        next_log_prob: log π(a'|o').
        alpha: α, the temperature.
        gamma: γ.
    """
    return rewards + gamma * ~terminations * (next_q - alpha * next_log_prob)


def squashed_log_prob(gaussian_log_prob: Float[Tensor, "n a"], pre_tanh: Float[Tensor, "n a"]) -> Float[Tensor, " n"]:
    """Log π(a) of a = tanh(u), u Gaussian: Σ log N(u) - log(1 - tanh²u), stably (Haarnoja et al. 2018, eq. 21)."""
    log_slope = 2.0 * (0.6931471805599453 - pre_tanh - nnf.softplus(-2.0 * pre_tanh))
    return (gaussian_log_prob - log_slope).sum(-1)
