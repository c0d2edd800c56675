"""How fast does each stage of a config train on this machine, and how long would the whole config take?

    python benchmarks/stages.py                                                                  # pendulum_hard.yaml
    python benchmarks/stages.py --config configs/walker_hard.yaml configs/presets/paper.yaml     # the paper's size
    python benchmarks/stages.py --config ... --longer 10     # on a GPU, where a unit is much shorter than the start-up

Every stage runs twice, shortened, with the config's own networks, images and batches; the difference of the two gives
seconds a unit without the start-up. Writes results/stages.csv: what a unit is, its seconds, how many the config asks
for in all its grounding steps, and the hours that makes. Evaluation and collection are left out.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

import torch
from tables import replace_rows

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
FIELDS = ("config", "stage", "unit", "seconds_each", "units", "hours", "device", "threads")
LENGTHS = {
    # stage: unit, in the schedule, short and long, both in its unit
    "state_predictor": ("batch", "state_predictor", 20, 60),
    "visual": ("batch", "visual", 3, 9),
    "dynamics": ("GARAT environment step", "dynamics", 1, 2),
    "policy": ("environment step", "policy", 20, 60),
}
ROLLOUT = 200
WARM_UP = 20


def overrides(lengths: dict[str, int]) -> dict[str, object]:
    """A schedule of one short grounding step, whose data take no time: what explores has learned nothing."""
    stages = {f"schedule.{part}.{name}": n for part in ("pretrain", "finetune") for name, n in lengths.items()}
    return stages | {
        "episodes": 1, "schedule.grounding_steps": 1, "schedule.images": 100, "schedule.interactions": 50,
        "schedule.source_policy": 20, "schedule.lengths": "given", "schedule.exploration": "random",
        "feeding.warmup_steps": WARM_UP, "feeding.garat_rollout": ROLLOUT,
    }  # fmt: skip


def layers(configs: list[Path]) -> list[str]:
    """The command line's options for configs, each laid over those before it."""
    return [option for config in configs for option in ("--config", str(config))]


def seconds(configs: list[Path], lengths: dict[str, int], folder: Path) -> dict[str, float]:
    """Seconds that every stage of the grounding step took, dynamics and the others."""
    values = {**overrides(lengths), "run_dir": folder}
    command = [sys.executable, "-m", "cli", "fit", *layers(configs), *(f"--{k}={v}" for k, v in values.items())]
    subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    stages = json.loads((folder / "summary.json").read_text())["stages"]
    return {s["stage"]: s["wall_s"] for s in stages if s["step"] == 1 and s["stage"] in LENGTHS}


def rows(configs: list[Path], longer: int) -> list[dict]:
    """The table of one config, and of presets laid over it; `longer` multiplies the stages' lengths."""
    from cli.fit import GroundingCLI

    whole = GroundingCLI(layers(configs)).config
    schedule = whole.schedule
    with tempfile.TemporaryDirectory() as folder:
        times = [
            seconds(configs, {name: longer * spec[i] for _, (_, name, *spec) in LENGTHS.items()}, Path(folder) / str(i))
            for i in (0, 1)
        ]
    table = []
    for stage, (unit, name, short, long) in LENGTHS.items():
        size = ROLLOUT if stage == "dynamics" else 1
        each = (times[1][stage] - times[0][stage]) / (longer * (long - short) * size)
        units = schedule.pretrain[name] + schedule.grounding_steps * schedule.finetune[name]
        units *= whole.feeding.garat_rollout if stage == "dynamics" else 1
        table.append({
            "config": "+".join(c.stem for c in configs), "stage": stage, "unit": unit,
            "seconds_each": float(f"{each:.3g}"), "units": units,
            "hours": round(each * units / 3600, 2), "threads": torch.get_num_threads(),
            "device": torch.cuda.get_device_name() if torch.cuda.is_available() else platform.machine(),
        })  # fmt: skip
    return table


def main() -> None:
    """Run the benchmark; rows of other configs stay."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument(
        "--config", type=Path, nargs="+", default=[ROOT / "configs/pendulum_hard.yaml"], help="later over earlier"
    )
    p.add_argument("--longer", type=int, default=1, help="run every stage so many times as long")
    p.add_argument("--out", type=Path, default=ROOT / "results/stages.csv")
    o = p.parse_args()
    replace_rows(o.out, rows(o.config, o.longer), ("config",), FIELDS)
    print(o.out.read_text())


if __name__ == "__main__":
    main()
