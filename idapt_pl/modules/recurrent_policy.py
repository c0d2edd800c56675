"""Adaptive RL: asymmetric SAC with LSTMs in actor and critics, which find out over time what world they are in."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from idapt_pl.losses import sac_target
from idapt_pl.modules.actor_critic import Actor, TwinCritic
from idapt_pl.modules.policy import AsymmetricSAC

REMEMBERED = ("ended", "before", "actor_memory", "critic_memory")
"""What replay keeps of a transition beside it: whether it ended its episode, and what was known before it."""


@dataclass
class LstmMemory:
    """What a recurrent policy knows of n episodes that are under way.

    Attributes:
        hidden: output and cell of the LSTM, (n, 2 h).
        action: the last one taken, -1..1, (n, nu); 0 before the first.
    """

    hidden: Tensor
    action: Tensor
    lost = None

    def forget(self, which: Tensor) -> None:
        """Begin anew in some episodes."""
        self.hidden[which], self.action[which] = 0.0, 0.0

    def copy(self) -> LstmMemory:
        """As it is now."""
        return LstmMemory(self.hidden.clone(), self.action.clone())

    def put_back(self, before: LstmMemory, which: Tensor) -> None:
        """What is known of some episodes is what it was before."""
        self.hidden[which], self.action[which] = before.hidden[which], before.action[which]


class Recurrence(nn.Module):
    """An LSTM over what is seen and the actions between; its output stands beside what is seen.

    Args:
        seen: size of what is seen.
        action_dim: nu.
        hidden: of the LSTM.
    """

    def __init__(self, seen: int, action_dim: int, hidden: int) -> None:
        super().__init__()
        self.hidden, self.features = hidden, seen + hidden
        self.lstm = nn.LSTM(seen + action_dim, hidden, batch_first=True)

    def forward(self, seen: Tensor, before: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """What is seen (b, t, d) with what the LSTM makes of it (b, t, d + h), and its memory (b, 2 h) after the last.

        Args:
            seen: over time.
            before: the actions taken just before, -1..1, (b, t, nu).
            memory: before the first.
        """
        start = tuple(part[None].contiguous() for part in memory.chunk(2, -1))
        out, last = self.lstm(torch.cat([seen, before], -1), start)
        return torch.cat([seen, out], -1), torch.cat([part[0] for part in last], -1)

    def step(self, seen: Tensor, memory: LstmMemory) -> Tensor:
        """As :meth:`forward`, of one moment (n, d); ``memory`` goes on."""
        out, memory.hidden = self(seen[:, None], memory.action[:, None], memory.hidden)
        return out[:, 0]


class RecurrentCritic(nn.Module):
    """Two Q on states and what an LSTM makes of them over time.

    Args:
        state_dim: size of s.
        actor: whose action bounds scale a.
        hidden: of both Q.
        recurrent: of the LSTM.
    """

    def __init__(self, state_dim: int, actor: Actor, hidden: Sequence[int], recurrent: int) -> None:
        super().__init__()
        self.recurrence = Recurrence(state_dim, len(actor.center), recurrent)
        self.twin = TwinCritic(self.recurrence.features, actor, hidden)

    def forward(self, seen: Tensor, action: Tensor) -> Tensor:
        """Both values, (2, n), of what :attr:`recurrence` gives (n, d) and actions (n, nu)."""
        return self.twin(seen, action)


class RecurrentSAC(AsymmetricSAC):
    """Asymmetric SAC with LSTMs (Adaptive RL in the paper): ``recurrent`` is their size.

    Replay keeps what actor and critics knew before every transition. Updates are on stretches of ``sequence``
    transitions, begun with that; those after the end of an episode do not count. The loss is of all the others, where
    the authors' code takes the last of each stretch.
    """

    def make_actor(self, f: nn.Module, low: list[float], high: list[float], hidden: Sequence[int]) -> Actor:
        recurrence = Recurrence(f.features, len(low), self.hparams.recurrent)
        actor = Actor(f, low, high, hidden, seen=recurrence.features)
        actor.recurrence = recurrence
        return actor

    def add_networks(self, actor: Actor, state_dim: int) -> None:
        super().add_networks(actor, state_dim)
        self.critic = RecurrentCritic(state_dim, actor, self.hparams.hidden, self.hparams.recurrent)
        self.critic_target = copy.deepcopy(self.critic).requires_grad_(False)

    # --- acting -------------------------------------------------------------------------------------

    def begin(self, n: int) -> Any:
        like = self.actor.center
        return LstmMemory(like.new_zeros(n, 2 * self.hparams.recurrent), like.new_zeros(n, len(like)))

    def remembering(self, features: Tensor, memory: Any) -> Tensor:
        """f(o) (n, d) with what the LSTM makes of it."""
        return self.actor.recurrence.step(features, memory)

    @torch.no_grad()
    def features_of(self, seen: dict[str, np.ndarray]) -> Tensor:
        """f(o) (n, d) of what :meth:`remember` returned."""
        images = seen["observation"]
        return self.encode(images) if images.dtype == np.uint8 else torch.from_numpy(images).to(self.device)

    # --- learning -----------------------------------------------------------------------------------

    def critic_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Regress both critics on the soft Bellman target, at all transitions of the stretches that count."""
        w, counts = self.hparams, counting(batch["ended"])
        with torch.no_grad():
            seen = self.actor_sees(batch)[:, 1:]
            action, log_prob = self.actor(seen.flatten(0, 1))
            slow = self.critic_sees(batch, self.critic_target)[:, 1:]
            next_q = torch.minimum(*self.critic_target(slow.flatten(0, 1), action))
            flat = {k: batch[k].flatten(0, 1) for k in ("rewards", "actions", "next_state", "terminations")}
            rewards = self.shaped_rewards(flat)
            target = sac_target(rewards, flat["terminations"], next_q, log_prob, self.log_alpha.exp(), w.gamma)
        q = self.critic(self.critic_sees(batch, self.critic)[:, :-1].flatten(0, 1), flat["actions"])
        loss = 2 * ((q - target).square() * counts).sum() / (2 * counts.sum())
        self.descend(self.optimizers()[0], loss)
        return {"policy/critic_loss": loss.detach(), "policy/q": q.detach()}

    def actor_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Improve actor and temperature, at all transitions of the stretches that count."""
        counts = counting(batch["ended"])
        action, log_prob = self.actor(self.actor_sees(batch)[:, :-1].flatten(0, 1))
        with torch.no_grad():
            known = self.critic_sees(batch, self.critic)[:, :-1].flatten(0, 1)
        q = torch.minimum(*self.critic(known, action))
        alpha, share = self.log_alpha.exp(), counts / counts.sum()
        loss = ((alpha.detach() * log_prob - q) * share).sum()
        target = self.entropy_wanted
        of_alpha = 0.0 if target is None else alpha * ((log_prob.detach() * share).sum() + target)
        self.descend(self.optimizers()[1], loss - of_alpha)
        told = {"policy/actor_loss": loss.detach(), "policy/entropy": -log_prob.detach()}
        return told | {"policy/temperature": alpha.detach()}

    def actor_sees(self, batch: dict[str, Tensor]) -> Tensor:
        """What the actor sees before and after every transition of stretches, (b, t + 1, d)."""
        observations = in_line(batch["observation"], batch["next_observation"])
        f = self.features(observations.flatten(0, 1)).unflatten(0, observations.shape[:2])
        return self.actor.recurrence(f, self.actions_before(batch), batch["actor_memory"][:, 0])[0]

    def critic_sees(self, batch: dict[str, Tensor], critic: RecurrentCritic) -> Tensor:
        """What a critic sees before and after every transition of stretches, (b, t + 1, d)."""
        states = in_line(batch["state"], batch["next_state"])
        return critic.recurrence(states, self.actions_before(batch), batch["critic_memory"][:, 0])[0]

    def actions_before(self, batch: dict[str, Tensor]) -> Tensor:
        """The actions taken just before what is seen, -1..1, (b, t + 1, nu)."""
        return in_line(batch["before"], self.actor.normalise(batch["actions"]))

    def trained_by_the_actor_loss(self) -> list[nn.Parameter]:
        if not self.supervised:
            return list(self.actor.parameters())
        return [*self.actor.head.parameters(), *self.actor.recurrence.parameters()]


def in_line(here: Tensor, after: Tensor) -> Tensor:
    """(b, t, ...) before and after each transition to (b, t + 1, ...): the first, then what followed each."""
    return torch.cat([here[:, :1], after], 1)


def counting(ended: Tensor) -> Tensor:
    """Which transitions of stretches, bool (b, t), are of the episode that the stretch begins in; 1 or 0, (b t,)."""
    before = torch.cat([torch.zeros_like(ended[:, :1]), ended[:, :-1]], 1)
    return (before.cumsum(1) == 0).float().flatten()
