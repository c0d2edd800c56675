"""Errors of translations with source and target put into the same states (evaluation only)."""

from __future__ import annotations

import numpy as np
import torch

from idapt_pl.envs import VectorImageEnv
from idapt_pl.modules import AsymmetricSAC, StatePredictor, VisualTransformation
from idapt_pl.rl.policy import Acting
from idapt_pl.worlds import Worlds


@torch.no_grad()
def paired_errors(
    worlds: Worlds, policy: AsymmetricSAC, G: VisualTransformation, P_S: StatePredictor, steps: int, seed: int
) -> dict:
    """Errors with source and target put into the same states (evaluation only).

    Returns:
        ``psnr`` of G(o^S) against the target's image, dB; mean absolute state errors, one for each
        component: ``state_source`` P^S(o^S), ``state_translated`` P^T(G(o^S)), ``state_target`` P^T(o^T).
        Empty where the target cannot be put into a state.
    """
    twin = worlds.target_twin()
    if twin is None:
        return {}
    source, target, states = paired_stacks(worlds, twin, policy, G, steps, seed)
    n, k = source.shape[:2]
    frames = source if G.frames > 1 else source.reshape(n * k, 1, *source.shape[2:])
    fake = np.concatenate([G.translate(part) for part in np.array_split(frames, len(frames) // 64 + 1)]).reshape(
        source.shape
    )
    error = np.square(fake[:, -1].astype(float) - target[:, -1]).mean()

    def mae(predictor: torch.nn.Module, pixels: np.ndarray) -> list[float]:
        predicted = predictor.predict(torch.from_numpy(pixels)).numpy()
        return [round(float(v), 4) for v in np.abs(predicted - states).mean(0)]

    result = {"psnr": round(float(10 * np.log10(255**2 / max(error, 1e-9))), 2), "state_source": mae(P_S.P_S, source)}
    if G.P_T is not None:
        result |= {"state_translated": mae(G.P_T, fake), "state_target": mae(G.P_T, target)}
    return result


def paired_stacks(
    worlds: Worlds, twin: VectorImageEnv, policy: AsymmetricSAC, G: VisualTransformation, steps: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Source and target frame stacks of the same states, along a grounded rollout of ``policy``; closes ``twin``.

    Returns:
        source (n, K, H, W, 3), target (n, K, H, W, 3), states (n, state_dim).
    """
    env = worlds.grounded(1, G)
    obs, _ = env.reset(seed=seed)
    source = env.unwrapped
    assert isinstance(source, VectorImageEnv)  # what a grounded environment wraps
    data = source.data[0]
    sources, targets, states = [], [], []
    history: list[np.ndarray] = []
    fresh, act = True, Acting(policy)
    for _ in range(steps):
        frame = twin.show(0, data)
        history = [frame] * worlds.frame_stack if fresh else [*history[1:], frame]
        sources.append(obs["source_pixels"][0])
        targets.append(np.stack(history))
        states.append(obs["state"][0])
        obs, _, terminations, truncations, _ = env.step(act(obs["pixels"]))
        ended = terminations | truncations
        act.tick(ended)
        fresh = bool(ended[0])
    env.close()
    twin.close()
    return np.stack(sources), np.stack(targets), np.stack(states)
