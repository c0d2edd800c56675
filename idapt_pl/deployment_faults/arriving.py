"""Recordings whose actions are what arrives at the motors, for models that hold commands back or filter them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from datamodules import Trajectories
from idapt_pl.effects.runtime import Command, CommandEffect, mean_between


def as_commands_arrive(model: mujoco.MjModel, data: Trajectories, own: Sequence[CommandEffect]) -> Trajectories:
    """The same recordings with actions as the model's own delays and filters pass them on, means of control steps.

    Args:
        model: without what ``own`` says.
        data: the recordings.
        own: as of :func:`~idapt_pl.effects.own_signals.take_signals`.
    """
    if not own:
        return data
    episodes = []
    for e in data:
        time = data.dt * np.arange(len(e) + 1) if e.timestamps is None else np.asarray(e.timestamps, float)
        command = Command(time, np.asarray(e.actions, float))
        for effect in own:
            command = effect.transform(command, effect.columns(model), float(model.opt.timestep))
        arrived = mean_between(command, time[None])[0]
        episodes.append(replace(e, actions=arrived.astype(e.actions.dtype)))
    return replace(data, episodes=tuple(episodes))
