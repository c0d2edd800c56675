"""What `idapt diagnose` is compared with: mujoco.sysid on all parameters at once, and a residual network.

    pip install "mujoco[sysid]"
    python benchmarks/diagnosis_baselines.py --seeds 0       # cases with an effect inside the library; rows are kept
    python benchmarks/diagnosis_baselines.py --summary

The cases are those of benchmarks/diagnosis.py; errors are measured as there, on the same held-out windows.

``sysid``: every effect of the library that is one number of the MJCF, on each joint, actuator, body and geom of its
own, is a Parameter of mujoco.sysid, all are fitted together, and the largest change is named, in units of what is
noticeable (``sysid_named``) or of its own interval (``sysid_surest``): what a person would do who has that tool and no
suspicion. ``sysid_could`` says whether a right answer is among the parameters at all: delays and lags are not, nor what
all elements of a kind have in common. Commands are held, states start as measured, each channel is weighted by its
error under the nominal model.

``network``: a multilayer perceptron learns what the nominal model gets wrong in one control step from state and
command, and corrects the simulation step by step. It names nothing. Writes results/diagnosis_baselines.csv.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
import numpy as np
import torch
from mujoco import rollout
from tables import read_rows, write_rows
from tqdm import tqdm

from benchmarks.diagnosis import in_order, record
from benchmarks.other_fits import held_out_error, sysid_fit
from benchmarks.undeclared.cases import CASES, Case
from cli.provenance import git_commit
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.prediction.model import name_elements
from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.prediction.rolling import STATE
from idapt_pl.prediction.simulator import silence_mujoco
from idapt_pl.effects.candidate import Candidate
from idapt_pl.nets.mlp import mlp

FIELDS = (
    "case", "kind", "model", "seed", "optimizer", "before", "sysid_parameters", "sysid_could", "sysid_named",
    "sysid_top1", "sysid_surest", "sysid_surest_top1", "sysid_after", "sysid_seconds", "network_after",
    "network_seconds", "commit",
)  # fmt: skip
IDENTIFIABLE = [c.name for c in CASES.values() if c.kind in ("single", "double", "confounded")]

# --- mujoco.sysid ---------------------------------------------------------------------------------


def could_name(case: Case, singles: Sequence[Candidate]) -> int:
    """Whether a right answer is among the parameters."""
    return int(any((c.kind.name, c.target) in answer for c in singles for answer in case.accept))


def fit_all(
    case: Case, context: SearchContext, state: SearchState, spec: mujoco.MjSpec, optimizer: str, iterations: int
) -> dict:
    """The first baseline."""
    started = time.perf_counter()
    fit = sysid_fit(context, state, state.windows.screen.windows, spec, optimizer, iterations)
    sizes = np.abs(fit.change), np.abs(fit.change) / (fit.interval + 1e-12)
    largest, surest = (fit.parameters[int(np.argmax(size))] for size in sizes)
    accepted = set().union(*case.accept)
    return {
        "sysid_parameters": len(fit.parameters), "sysid_could": could_name(case, fit.parameters),
        "sysid_named": largest.label, "sysid_top1": int((largest.kind.name, largest.target) in accepted),
        "sysid_surest": surest.label, "sysid_surest_top1": int((surest.kind.name, surest.target) in accepted),
        "sysid_after": round(fit.after, 4), "sysid_seconds": round(time.perf_counter() - started, 1),
    }  # fmt: skip


# --- a residual network ---------------------------------------------------------------------------


def one_step(model: mujoco.MjModel, x: np.ndarray, u: np.ndarray, dt: float, data: list[mujoco.MjData]) -> np.ndarray:
    """States (n, nq + nv) one control step later."""
    full = np.zeros((len(x), mujoco.mj_stateSize(model, STATE)))
    full[:, 1 : 1 + x.shape[1]] = x
    with silence_mujoco():
        states, _ = rollout.rollout(model, data, full, np.repeat(u[:, None], round(dt / model.opt.timestep), 1))
    return np.nan_to_num(states[:, -1, 1 : 1 + x.shape[1]]).clip(-1e3, 1e3)


def network(context: SearchContext, state: SearchState, seed: int, epochs: int = 200) -> dict:
    """The second baseline."""
    started, sim = time.perf_counter(), context.sim
    torch.manual_seed(seed)
    data = [mujoco.MjData(sim.model) for _ in range(sim.threads)]

    def pairs(episodes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        states = [np.hstack([sim.data[e].qpos, sim.data[e].qvel]) for e in episodes]
        parts = [s[:-1] for s in states], [sim.data[e].actions for e in episodes], [s[1:] for s in states]
        return tuple(map(np.concatenate, parts))

    x, u, y = pairs(context.fit_episodes)
    wrong = y - one_step(sim.model, x, u, sim.control_period, data)
    seen = np.hstack([x, u])
    mean, std, unit = seen.mean(0), seen.std(0) + 1e-6, wrong.std(0) + 1e-9
    net = mlp(seen.shape[1], (128, 128), wrong.shape[1])
    optimizer = torch.optim.Adam(net.parameters(), lr=1e-3, weight_decay=1e-5)
    inputs, targets = (torch.tensor(a, dtype=torch.float32) for a in ((seen - mean) / std, wrong / unit))
    order = torch.randperm(len(inputs))
    train, check = order[len(order) // 8 :], order[: len(order) // 8]
    best, kept = torch.nn.functional.mse_loss(torch.zeros_like(targets[check]), targets[check]).item(), None
    for _ in range(epochs):
        for rows in train[torch.randperm(len(train))].split(256):
            optimizer.zero_grad()
            torch.nn.functional.mse_loss(net(inputs[rows]), targets[rows]).backward()
            optimizer.step()
        with torch.no_grad():
            loss = torch.nn.functional.mse_loss(net(inputs[check]), targets[check]).item()
        if loss < best:  # early stopping: the weights that did best on transitions left out
            best, kept = loss, {k: v.clone() for k, v in net.state_dict().items()}

    @torch.no_grad()
    def correction(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        if kept is None:
            return np.zeros_like(x)
        return net(torch.tensor((np.hstack([x, u]) - mean) / std, dtype=torch.float32)).numpy() * unit

    if kept is not None:
        net.load_state_dict(kept)
    w = state.windows.held_out.windows
    chosen = [(sim.data[e], s) for e, s in zip(w.episode, w.start, strict=True)]
    now = np.stack([np.hstack([r.qpos[s], r.qvel[s]]) for r, s in chosen])
    residual = []
    for k in range(w.offsets[-1]):
        u = np.stack([r.actions[s + k] for r, s in chosen])
        now = one_step(sim.model, now, u, sim.control_period, data) + correction(now, u)
        if k + 1 in w.offsets:
            residual.append(np.stack([np.hstack([r.qpos[s + k + 1], r.qvel[s + k + 1]]) for r, s in chosen]) - now)
    after = held_out_error(state, np.stack(residual, 1))
    return {"network_after": round(after, 4), "network_seconds": round(time.perf_counter() - started, 1)}


def run(case: Case, seed: int, o: argparse.Namespace) -> dict:
    """Both baselines on one case."""
    spec, data = record(case, seed, o)
    spec = name_elements(spec.copy())
    context, state = begin_search(spec, data, seed=seed)
    nominal = context.sim.residual(context.declared, state.windows.held_out.windows)
    before = held_out_error(state, nominal)
    return {
        "case": case.name, "kind": case.kind, "model": case.model, "seed": seed,
        "optimizer": o.optimizer, "before": round(before, 4),
        **fit_all(case, context, state, spec, o.optimizer, o.iterations), **network(context, state, seed),
        "commit": git_commit(),
    }  # fmt: skip


def summarise(rows: list[dict]) -> str:
    """Top-1 of the first, and the share of the removable error (squared, above the noise) that each removes."""

    def removed(name: str) -> str:
        before, after = (np.array([float(r[k]) for r in rows]) for k in ("before", name))
        share = (before**2 - after**2) / np.maximum(before**2 - 1, 1e-9)
        return f"{np.median(share):.3f} (quartiles {np.quantile(share, 0.25):.3f} to {np.quantile(share, 0.75):.3f})"

    top1, sure = ([int(r[k]) for r in rows if str(r[k])] for k in ("sysid_top1", "sysid_surest_top1"))
    could = [int(r["sysid_top1"]) for r in rows if int(r["sysid_could"])]
    return "\n".join(
        [
            f"mujoco.sysid, cases that it could name: top-1  {np.mean(could):.3f} (n = {len(could)})",
            f"mujoco.sysid, all parameters: top-1            {np.mean(top1):.3f} (n = {len(top1)})",
            f"mujoco.sysid, the surest change: top-1         {np.mean(sure):.3f} (n = {len(sure)})" if sure else "",
            f"mujoco.sysid: removable error removed, median  {removed('sysid_after')}",
            f"residual network: the same                     {removed('network_after')}",
            f"seconds a case, median                         {np.median([float(r['sysid_seconds']) for r in rows]):.0f}"
            f" and {np.median([float(r['network_seconds']) for r in rows]):.0f}",
        ]
    )


def main() -> None:
    """Run the missing rows and print the summary."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--cases", nargs="+", choices=sorted(IDENTIFIABLE), default=IDENTIFIABLE, metavar="CASE")
    p.add_argument("--seeds", nargs="+", type=int, default=[0])
    p.add_argument("--optimizer", choices=("mujoco", "scipy_parallel_fd"), default="mujoco", help="of mujoco.sysid")
    p.add_argument("--iterations", type=int, default=15, help="of mujoco.sysid's least squares, at most")
    p.add_argument("--summary", action="store_true", help="only print what is there")
    p.add_argument("--data", type=Path, default=ROOT / "runs" / "undeclared")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "diagnosis_baselines.csv")
    o = p.parse_args()
    o.positions = False
    rows = read_rows(o.out)
    done = {(r["case"], int(r["seed"]), r["optimizer"]) for r in rows}
    wanted = [(c, s) for s in o.seeds for c in o.cases if (c, s, o.optimizer) not in done and not o.summary]
    for name, seed in tqdm(wanted, unit="case", disable=not sys.stderr.isatty()):
        row = run(CASES[name], seed, o)
        rows.append(row)
        write_rows(o.out, in_order(rows), FIELDS)
        print(*(row[k] for k in FIELDS[:-1]), flush=True)
    for optimizer in sorted({r["optimizer"] for r in rows}):
        print(f"--- optimizer {optimizer}\n" + summarise([r for r in rows if r["optimizer"] == optimizer]))


if __name__ == "__main__":
    main()
