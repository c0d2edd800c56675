r"""Are hidden effects named from images alone, and nothing where nothing is hidden? One row a case and seed.

    python benchmarks/discovery.py --seeds 0 1 2 3 4
    python benchmarks/discovery.py --config cheetah_quick --target easy --seeds 0 --steps 4000
    python benchmarks/discovery.py --config cheetah_quick --seeds 0 --steps 4000 \
        --settings long --schedule.source_images 16000 --schedule.pretrain.estimator 4000
    python benchmarks/discovery.py --seeds 0 --runs runs/inverted_pendulum_hard   # the sensor of `make demo`

Targets look like the task's hard (or easy) domain and move like its source but for what is hidden. The sensor is the
estimator that a quick run has when it first looks for effects; a run is made up to there for each seed, or that of
``--runs`` is used. It was trained against that domain itself, so other cases than that domain's own effect use it on
motions that it was not trained on. ``--looks "source through G"`` shows the sensor what it was fitted to instead:
images of the source, as G translates them. Writes results/discovery.csv.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

import numpy as np
import quick
import yaml
from tables import replace_rows

from cli.provenance import git_commit
from idapt_pl.run import Run
from datamodules import Episode, write_trajectories
from idapt_pl.image_diagnosis import DiscoverySettings, ImageDiagnosis, discover_effects
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.effects import Domain, visual
from idapt_pl.effects.actuators import ActuatorGain
from idapt_pl.effects.base import ACTUATED, Effect
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.joints import JointArmature, JointDamping
from idapt_pl.effects.signals import ActuatorDelay
from idapt_pl.envs import VectorImageEnv
from idapt_pl.modules import VisualTransformation
from idapt_pl.rl.collect import collect

CASES: dict[str, dict[str, tuple[Effect, ...]]] = {
    "inverted_pendulum": {
        "nothing": (),
        "pole 200 kg": (BodyMass("pole", 200.0),),
        "pole 50 kg": (BodyMass("pole", 50.0),),
        "hinge damping": (JointDamping("hinge", 4.0),),
        "actuator gain": (ActuatorGain("slide", 0.6),),
        "action delay": (ActuatorDelay("slide", 0.04),),
        "pole 50 kg and hinge damping": (BodyMass("pole", 50.0), JointDamping("hinge", 20.0)),
        "actuator gain and action delay": (ActuatorGain("slide", 0.6), ActuatorDelay("slide", 0.04)),
    },
    "half_cheetah": {
        "nothing": (),
        "armature 0.4": (JointArmature(ACTUATED, 0.4),),
        "armature 0.18": (JointArmature(ACTUATED, 0.18),),
    },
    "walker2d": {
        "nothing": (),
        "torso 10 kg": (BodyMass("torso", 10.0),),
        "torso 5.4 kg": (BodyMass("torso", 5.4),),
    },
}
NO_MORE_THAN_THE_SENSOR = (
    "--effects.discover", "false", "--schedule.grounding_steps", "0", "--schedule.source_policy", "0",
    "--schedule.pretrain.policy", "0",
)  # fmt: skip
NO_TEACHER = ("--teacher.steps", "0", "--teacher.dagger", "0")
TARGET, TRANSLATED = "target", "source through G"
KEY = ("config", "looks", "case", "seed")
FIELDS = (
    *KEY, "found", "disbelieved", "right", "estimate", "low", "high", "truth", "covered",
    "before", "after", "excess", "explained", "removed_in_control", "target_interactions", "seconds", "commit",
)  # fmt: skip


@dataclass(frozen=True)
class Translated(ImageSensor):
    """A sensor to which all recordings are images of the source, seen through ``always``."""

    always: VisualTransformation

    def motion(self, episode: Episode, dt: float, G: VisualTransformation | None) -> tuple[np.ndarray, np.ndarray]:
        """As of the sensor."""
        return super().motion(episode, dt, self.always)


def run(name: str, hidden: tuple[Effect, ...], look: str, seed: int, steps: int, folder: Path) -> dict:
    """Record a target with something hidden, look for it."""
    opened = Run.open(folder)
    worlds, G = opened.worlds, opened.load_visual()
    sensor = ImageSensor(opened.load_estimator(), worlds.task, worlds.frame_stack)
    plain = worlds.task.domain("source")
    source = plain.with_effects(
        *painted(worlds.added_effects)
    )  # G was trained with these, and without what moves otherwise
    looks_like = () if look == TRANSLATED else painted(worlds.target_domain.effects[len(plain.effects) :])
    target = Domain("hidden", plain.base, (*plain.effects, *looks_like, *hidden))
    path, control = (folder / "hidden" / f"{n}.h5".replace(" ", "_") for n in (f"{name} {look}", "control"))
    record(opened, target, path, steps, seed + 100)
    if not control.exists():
        record(opened, source, control, steps, seed + 200)
    started = time.perf_counter()
    reads = Translated(**vars(sensor), always=G) if look == TRANSLATED else sensor
    result = discover_effects(source, reads, G, [path], [control], DiscoverySettings(True), seed, worlds.image_env)
    return {"target_interactions": steps, **score(result, hidden), "seconds": round(time.perf_counter() - started, 1)}


def painted(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The visual ones."""
    return tuple(e for e in effects if type(e).__module__ == visual.__name__)


def sensor_run(config: str, target: str, seed: int, settings: str, extra: Sequence[str]) -> Path:
    """The folder of a quick run that ends where effects would first be looked for."""
    name = "_".join(filter(None, ("sensor", config, "" if target == "hard" else target, settings)))
    path = ROOT / f"configs/{config}.yaml"
    rehearses = yaml.safe_load(path.read_text()).get("schedule", {}).get("exploration") == "rehearse"
    teacher = () if rehearses else NO_TEACHER
    return quick.run(path, seed, ["--target", target, *NO_MORE_THAN_THE_SENSOR, *teacher, *extra], name)


def record(run: Run, domain: Domain, path: Path, steps: int, seed: int) -> None:
    """Images, states and actions of the run's exploration."""
    worlds = run.worlds
    with closing(VectorImageEnv(worlds.task, domain, 1, worlds.image_size, worlds.frame_stack, worlds.view)) as env:
        write_trajectories(path, collect(env, run.grounding.explore(seed), steps, seed, path.stem))


def believed(result: ImageDiagnosis) -> list[tuple[str, str]]:
    """Effects that are added, by name and target."""
    return [(e.name, e.target) for e in result.effects]


def score(result: ImageDiagnosis, hidden: tuple[Effect, ...]) -> dict:
    """Compare what was found with what was hidden."""
    doubted = [*((e.name, e.target) for e in result.rejected), *(e.key for e in result.negligible)]
    told = (believed(result), doubted)
    found, disbelieved = (" + ".join(f"{name}({target})" for name, target in keys) for keys in told)
    row = {"found": found, "disbelieved": disbelieved}
    row |= {k: round(getattr(result, k), 3) for k in ("before", "after", "excess", "explained")}
    if "control" in result.removed:  # forecasts seek nothing there
        row |= {"removed_in_control": round(result.removed["control"], 3)}
    if not hidden:
        return row | {"right": int(not found)}
    if len(hidden) > 1:
        return row | score_several(result, hidden)
    truth = hidden[0]
    parameter, value = next((k, v) for k, v in truth.to_dict()["parameters"].items())
    row |= {"truth": value, "right": 0}
    for e in result.estimates[:1]:
        alternatives = [e.key, *((other.effect, other.target) for other in e.equivalent)]
        row["right"] = int((truth.name, truth.target) in alternatives)
        if p := e.parameters.get(parameter) if e.key == (truth.name, truth.target) else None:
            row["estimate"] = p.estimate
            if p.ci95 is not None:
                low, high = p.ci95
                row |= {"low": low, "high": high, "covered": int(low <= value <= high)}
    return row


def score_several(result: ImageDiagnosis, hidden: tuple[Effect, ...]) -> dict:
    """Right is who believes in as many effects as are hidden, each of them itself or as what it could also be."""
    of = {e.key: e for e in result.estimates}
    named = [{of[key].key, *((o.effect, o.target) for o in of[key].equivalent)} for key in believed(result)]
    wanted = [(e.name, e.target) for e in hidden]
    matched = any(all(w in n for w, n in zip(order, named, strict=True)) for order in orders(wanted, len(named)))
    values = [next(iter(e.to_dict()["parameters"].values())) for e in hidden]
    estimates = [f"{next(iter(of[w].parameters.values())).estimate:.6g}" if w in of else "" for w in wanted]
    return {
        "truth": " + ".join(f"{v:g}" for v in values), "estimate": " + ".join(estimates), "right": int(matched)
    }  # fmt: skip


def orders(wanted: list[tuple[str, str]], named: int) -> Iterator[tuple[tuple[str, str], ...]]:
    """All orders of what is hidden; none where another number of effects is named."""
    return itertools.permutations(wanted) if len(wanted) == named else iter(())


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--config", default="pendulum_quick", help="of the runs whose sensors are used")
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    known = list(dict.fromkeys(c for of in CASES.values() for c in of))
    p.add_argument("--cases", nargs="+", choices=known, metavar="CASE", help=f"default all of the task; of {known}")
    p.add_argument("--target", choices=("easy", "hard"), default="hard", help="what targets look like")
    p.add_argument("--looks", choices=(TARGET, TRANSLATED), default=TARGET, help="what the sensor sees")
    p.add_argument("--steps", type=int, default=5000, help="control steps taken in the target")
    p.add_argument("--runs", help="folders of runs, less _<seed>; default: made as far as needed, runs/sensor_<config>")
    p.add_argument("--out", type=Path, default=ROOT / "results/discovery.csv")
    p.add_argument(
        "--settings", default="", help="name in the table, for a sensor made with other settings of `idapt fit`"
    )
    o, extra = p.parse_known_args()
    if extra and not o.settings:
        p.error(f"settings of `idapt fit` need a name in the table: give --settings NAME with {' '.join(extra)}")
    config = " ".join(filter(None, (o.config, o.settings)))
    for seed in o.seeds:
        folder = Path(f"{o.runs}_{seed}") if o.runs else sensor_run(o.config, o.target, seed, o.settings, extra)
        worlds = Run.open(folder).worlds
        cases, look = CASES[worlds.task.name], o.looks if o.looks == TRANSLATED else worlds.target_domain.name
        for name in o.cases or cases:
            about = {"config": config, "looks": look, "case": name, "seed": seed}
            row = about | run(name, cases[name], look, seed, o.steps, folder) | {"commit": git_commit()}
            print({k: v for k, v in row.items() if v != ""}, flush=True)
            replace_rows(o.out, [row], KEY, FIELDS)


if __name__ == "__main__":
    main()
