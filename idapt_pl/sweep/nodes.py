"""The machines of a Ray cluster: whether there are any, and whether each can carry out runs."""

from __future__ import annotations

import importlib.metadata
import socket
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from idapt_pl.sweep.settings import RunResources

ANSWERS_WITHIN = 120.0
"""Seconds in which a machine must have imported the package."""


@dataclass(frozen=True)
class SeenNode:
    """A machine of the cluster.

    Attributes:
        name: its address.
        cpus, gpus: that Ray may give away.
        version: of the package there; empty if there is none.
        error: why it cannot be used, in its own words.
        sees: whether the sweep's folder is there.
    """

    name: str
    cpus: float
    gpus: float
    version: str = ""
    error: str = ""
    sees: bool = True


def reachable(address: str) -> None:
    """Knock where a cluster is said to be, which is quicker than to wait for its answer.

    Raises:
        OSError: if nobody opens.
    """
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if address == "auto":
        return
    if not host or not port.isdecimal():
        raise ValueError("expected auto, local, HOST:PORT or ray://HOST:PORT")
    socket.create_connection((host.strip("[]"), int(port)), timeout=5).close()


def look_at_nodes(ray: Any, folder: Path | None) -> list[SeenNode]:
    """Ask every machine of the cluster for the package and the sweep's folder.

    Args:
        ray: the module, connected.
        folder: that all must see; None if they need not.
    """
    nodes = [node for node in ray.nodes() if node["Alive"] and node["Resources"].get("CPU")]
    strategy = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy
    probe = ray.remote(num_cpus=0, max_retries=0)(probing())
    sign = None if folder is None else str(folder / "plan.json")
    asked = [probe.options(scheduling_strategy=strategy(node["NodeID"], soft=False)).remote(sign) for node in nodes]
    return [seen_node(ray, node, answer) for node, answer in zip(nodes, asked, strict=True)]


def seen_node(ray: Any, node: dict[str, Any], answer: Any) -> SeenNode:
    """What a machine has answered."""
    resources = node["Resources"]
    seen = {"name": node["NodeManagerAddress"], "cpus": resources["CPU"], "gpus": resources.get("GPU", 0.0)}
    try:
        return SeenNode(**seen, **ray.get(answer, timeout=ANSWERS_WITHIN))
    except Exception as error:  # whatever happens there
        return SeenNode(**seen, error=" ".join(str(error).split())[-200:] or type(error).__name__)


def probing() -> Callable[[str | None], dict[str, Any]]:
    """The function that a machine is asked with; made here, so that it travels whole and needs nothing there."""

    def probe(sign: str | None) -> dict[str, Any]:
        import importlib
        import importlib.metadata
        import os

        found: dict[str, Any] = {"sees": sign is None or os.path.exists(sign)}
        try:
            importlib.import_module("idapt_pl.sweep.work")
            importlib.import_module("cli.main")
            found["version"] = importlib.metadata.version("idapt")
        except Exception as error:
            found["error"] = f"{type(error).__name__}: {error}"[:200]
        return found

    return probe


def check_nodes(nodes: Sequence[SeenNode], resources: RunResources, folder: str) -> int:
    """How many runs go side by side on all machines together.

    Args:
        nodes: of the cluster.
        resources: of each run.
        folder: of the sweep.

    Raises:
        ValueError: if a machine lacks the package, has another version, or does not see the folder; or none is large
            enough.
    """
    mine = importlib.metadata.version("idapt")
    for node in nodes:
        if node.error or not node.version:
            raise ValueError(
                f"the node {node.name} cannot run idapt ({node.error or 'it has no such package'}); install the same "
                "version there as here"
            )
        if node.version != mine:
            raise ValueError(f"the node {node.name} has idapt {node.version}, here it is {mine}; install one version")
        if not node.sees:
            raise ValueError(
                f"the node {node.name} sees no {folder}; name a folder that all nodes share, or give "
                "storage in the sweep's YAML"
            )
    fit = [fits(node, resources) for node in nodes]
    if not any(fit):
        largest = max((f"{node.cpus:g} cpus and {node.gpus:g} gpus" for node in nodes), default="none")
        raise ValueError(
            f"a run takes {resources.cpus} cpus and {resources.gpus:g} gpus (resources), but no node has "
            f"as many: {largest}"
        )
    return sum(fit)


def fits(node: SeenNode, resources: RunResources) -> int:
    """How many runs go side by side on a machine."""
    by_cores = int(node.cpus // resources.cpus)
    return by_cores if resources.gpus == 0 else min(by_cores, int(node.gpus / resources.gpus + 1e-9))
