"""How wrong a policy is about the state while it acts (evaluation only)."""

from __future__ import annotations

import numpy as np

from idapt_pl.envs.image_env import Observations
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.rl.policy import Acting


class EstimateErrors:
    """Compares what a policy takes for the state with the true one, step by step; for supervised encoders.

    Args:
        act: the policy at work.
    """

    def __init__(self, act: Acting) -> None:
        self.act = act
        self._errors: dict[str, list[np.ndarray]] = {"readings": [], "estimates": []}

    def __call__(self, obs: Observations) -> None:
        """The policy has just acted on what came with these true states."""
        encoder = self.act.module.actor.encoder
        if not isinstance(encoder, PixelStatePredictor):
            return
        for name, seen in (("readings", self.act.readings), ("estimates", self.act.estimates)):
            assert seen is not None  # it has acted
            if seen.shape[-1] != len(encoder.mean):
                continue  # no estimates of states, but what an LSTM makes of readings
            states = (seen * encoder.std + encoder.mean).cpu().numpy()
            self._errors[name].append(np.abs(states - obs["state"]).mean(0))

    def to_dict(self) -> dict:
        """Mean absolute errors of each component of the state, in its units.

        ``readings`` is what a stack of frames tells, ``estimates`` what filter or physics make of it; ``lost`` is
        the share of steps in which they lost the state, which is known where the true states are not.
        """
        found = {name: np.mean(each, 0, dtype=float).round(4).tolist() for name, each in self._errors.items() if each}
        if self.act.lost is None:
            return {"readings": found["readings"]} if found else {}
        return found | {"lost": round(self.act.lost, 4)}
