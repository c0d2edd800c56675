"""A policy as one ONNX file that needs neither this project nor a simulator: images and memory in, actions out."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from idapt_pl.files import write_atomically
from idapt_pl.modules.export import require_packages
from idapt_pl.modules.policy import AsymmetricSAC


class DeployedPolicy(nn.Module):
    """The policy acting with its mean, in the robot's units.

    Args:
        policy: the trained module.
        order: which of the policy's actions each of the robot's is.
        scale: what a unit of the policy's is in the robot's.
        offset: what the policy's zero is.
        low: lower bounds of the robot's actions.
        high: upper bounds.
    """

    def __init__(
        self,
        policy: AsymmetricSAC,
        order: np.ndarray,
        scale: np.ndarray,
        offset: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
    ) -> None:
        super().__init__()
        self.actor, self.filter = policy.actor, policy.filter
        self.order = order.tolist()
        for name, values in {"scale": scale, "offset": offset, "low": low, "high": high}.items():
            self.register_buffer(name, torch.tensor(values.tolist(), dtype=torch.float32))
        nu = len(self.actor.center)
        self.parts = [self.filter.hidden, nu, self.filter.state_dim] if self.filter is not None else [0]

    @property
    def memory_size(self) -> int:
        """Numbers that are remembered from step to step; 0 where nothing is."""
        return sum(self.parts)

    def forward(
        self, pixels: UInt8[Tensor, "1 k s s 3"], memory: Float[Tensor, "1 m"]
    ) -> tuple[Float[Tensor, "1 a"], Float[Tensor, "1 m"]]:
        """Action for the last K frames, and the memory for the next step; it begins with zeros."""
        features = self.actor.encoder.encode(pixels)
        if self.filter is not None:
            hidden, action, reading = memory.split(self.parts, -1)
            reading = torch.where(torch.isfinite(features), features, reading)
            features, hidden = self.filtered(reading, action, hidden)
        mean = self.actor.head(features).chunk(2, -1)[0]
        chosen = self.actor.center + self.actor.half_range * torch.tanh(mean)
        if self.filter is not None:
            memory = torch.cat([hidden, self.actor.normalise(chosen), reading], -1)
        return (self.scale * chosen[:, self.order] + self.offset).clamp(self.low, self.high), memory

    def filtered(self, reading: Tensor, action: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """As :meth:`.StateFilter.step`, without a branch: it begins anew where the state is lost, with zeros."""
        assert self.filter is not None
        estimates, _ = self.filter(reading[:, None], action[:, None], hidden)
        kept = (~self.filter.lost(reading, estimates[:, 0])).to(hidden.dtype)[:, None]
        estimates, hidden = self.filter(reading[:, None], (action * kept)[:, None], hidden * kept)
        return self.filter.bounded(estimates[:, 0]), hidden


def export_policy(deployed: DeployedPolicy, path: Path, frames: int, image_size: int, about: dict[str, Any]) -> None:
    """Write an ``.onnx`` file. What a robot's side must know is in its metadata, as JSON under ``idapt``.

    Args:
        deployed: what is exported.
        path: of the file.
        frames: K.
        image_size: side of the frames, pixels.
        about: for the metadata.

    Raises:
        ValueError: if the ending is another, or a package is missing.
    """
    if path.suffix != ".onnx":
        raise ValueError(f"{path}: the ending must be .onnx")
    require_packages("onnx", "onnxscript")
    deployed = deployed.cpu().eval().requires_grad_(False)
    example = torch.zeros(1, frames, image_size, image_size, 3, dtype=torch.uint8)
    inputs = (example, torch.zeros(1, deployed.memory_size))
    onnx = torch.onnx.export(
        deployed, inputs, dynamo=True, input_names=["pixels", "memory"], output_names=["action", "next_memory"],
        verbose=False,
    )  # fmt: skip
    known = {"image_size": image_size, "frames": frames, "memory": deployed.memory_size}
    onnx.model.metadata_props["idapt"] = json.dumps(known | about)
    write_atomically(path, lambda temporary: onnx.save(temporary, external_data=False))


def open_session(path: Path) -> Any:
    """A file ready to run, on one CPU core.

    Raises:
        ValueError: if onnxruntime is missing.
    """
    require_packages("onnxruntime")
    runtime = importlib.import_module("onnxruntime")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    return runtime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def played_by_file(path: Path, stacks: UInt8[np.ndarray, "t k s s 3"]) -> np.ndarray:
    """Actions (T, nu) that a file gives for the frame stacks of an episode."""
    session = open_session(path)
    memory, actions = np.zeros((1, session.get_inputs()[-1].shape[-1]), np.float32), []
    given = {i.name for i in session.get_inputs()}
    for stack in stacks:
        inputs = {name: value for name, value in (("pixels", stack[None]), ("memory", memory)) if name in given}
        action, memory = session.run(None, inputs)
        actions.append(action[0])
    return np.array(actions)
