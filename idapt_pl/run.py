"""A run: what its config says, and what its folder holds. Made by ``idapt fit``, opened by everything else."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jsonargparse import ArgumentParser, Namespace

from idapt_pl.effects import View, effect_from_dict
from idapt_pl.envs.ledger import Ledger
from idapt_pl.evaluation.evaluation import Evaluation
from idapt_pl.files import blaming, read_json
from idapt_pl.grounding import IterativeGrounding
from idapt_pl.image_diagnosis import DiscoverySettings
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, StatePredictor, VisualTransformation
from idapt_pl.modules.ranges import MODULE_RANGES
from idapt_pl.nets.encoder import PixelStatePredictor, Vision
from idapt_pl.ranges import IMAGE_SIZE, SEED, Range, check_ranges
from idapt_pl.rendering.parallel import usual_processes
from idapt_pl.run_folder.interactions import disagreements, held_interactions, reconciled
from idapt_pl.run_folder.kept_config import read_kept_config, without_retired
from idapt_pl.run_folder.results import effect_files
from idapt_pl.stage import MakeTrainer, Stages, cpu_trainer, load_finished
from idapt_pl.stages.aside import Aside, in_turn
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.distillation import Distillation, TeacherSettings
from idapt_pl.stages.schedule import Schedule, check_memory, fill_lengths, length_of
from idapt_pl.stages.settings import BatchSettings, FilterSettings, LabelSettings, ModuleFactories
from idapt_pl.tasks import TASKS, make_task
from idapt_pl.worlds import Worlds

log = logging.getLogger(__name__)

DIMENSIONS = {"state_dim", "image_size", "frame_stack", "action_low", "action_high", "rates", "dt", "vision"}
"""Constructor arguments that the task and the data determine, never typed in a config."""

MODULES: dict[str, type] = {
    "state_predictor": StatePredictor,
    "visual": VisualTransformation,
    "dynamics": ActionTransformation,
    "policy": AsymmetricSAC,
}
"""What is learned, by its key in a config."""

SETTINGS: dict[str, type] = {
    "view": View,
    "schedule": Schedule,
    "effects": DiscoverySettings,
    "feeding": BatchSettings,
    "teacher": TeacherSettings,
    "filter": FilterSettings,
    "labels": LabelSettings,
    "vision": Vision,
}
"""Everything else that a config sets, by its key."""


@dataclass(frozen=True)
class RunConfig:
    """One config key for each thing there is.

    Attributes:
        task: name of the task.
        target: name of the target domain.
        seed: root seed; every stage derives its own.
        run_dir: run folder; None for ``runs/<task>_<target>_<seed>``.
        image_size: side of the rendered images, pixels.
        frame_stack: K, frames in an observation.
        render_processes: further processes that render; None for one on each core but one, at most 3.
        threads: of torch; None for the cores that nobody else uses, looked at every few seconds.
        side_by_side: run what does not depend on each other in two processes; None where a second core is free for it.
        episodes: for each reported return.
        oracle: also train the oracle reference in the target.
        view: the part of the camera's image that is rendered.
        schedule: what Algorithm 1 does, and for how long.
        effects, feeding, teacher: whether effects are sought; sizes of batches and rollouts; a privileged teacher.
        filter: how the policy's filter learns, if it has one.
        labels: how images of the target get states to learn from, if they do.
        vision: how images are looked at.
        modules: constructor arguments of each of :data:`MODULES`.
    """

    task: str
    target: str
    seed: int
    run_dir: str | None
    image_size: int
    frame_stack: int
    render_processes: int | None
    threads: int | None
    side_by_side: bool | None
    episodes: int
    oracle: bool
    view: View
    schedule: Schedule
    effects: DiscoverySettings
    feeding: BatchSettings
    teacher: TeacherSettings
    filter: FilterSettings
    labels: LabelSettings
    vision: Vision
    modules: dict[str, dict[str, Any]]

    @staticmethod
    def add_arguments(parser: ArgumentParser) -> None:
        """Give a parser an option for every key."""
        parser.add_argument("--seed", type=int, default=0, help="root seed; every stage derives its own")
        parser.add_argument("--run_dir", type=str, default=None, help="run folder; default runs/<task>_<target>_<seed>")
        parser.add_argument("--task", type=str, default="inverted_pendulum", help=f"one of: {', '.join(TASKS)}")
        parser.add_argument("--target", type=str, default="hard", help="target domain: easy or hard")
        parser.add_argument("--image_size", type=int, default=100, help="side of the rendered images, pixels")
        parser.add_argument(
            "--render_processes",
            type=int | None,
            default=None,
            help="further processes that render where several simulations run side by side; default one for each core "
            "but one, at most 3. Images do not depend on it",
        )
        parser.add_argument(
            "--threads",
            type=int | None,
            default=None,
            help="threads that a stage computes with; default as many as there are cores that nobody else uses, looked "
            "at every few seconds. With a fixed number two runs with one seed agree to the bit on a busy machine too",
        )
        parser.add_argument(
            "--side_by_side",
            type=bool | None,
            default=None,
            help="run what does not depend on each other (the source policy and G, an evaluation and the next step) in "
            "two processes, with the same results; default where there are two cores and no GPU",
        )
        parser.add_class_arguments(View, "view")
        parser.add_argument("--frame_stack", type=int, default=3, help="frames in an observation")
        parser.add_argument("--episodes", type=int, default=20, help="episodes for each reported return")
        parser.add_argument("--oracle", type=bool, default=False, help="also train the oracle reference in the target")
        for name, settings in SETTINGS.items():
            if name != "view":
                parser.add_class_arguments(settings, name)
        for name, module in MODULES.items():
            skip = DIMENSIONS | ({"encoder"} if name == "dynamics" else set())
            parser.add_class_arguments(module, name, skip=skip, instantiate=False)

    @classmethod
    def from_namespace(cls, config: Namespace) -> RunConfig:
        """From what a parser with these options instantiated.

        Raises:
            ValueError: if settings contradict each other.
        """
        values = {name: config[name] for name in cls.__dataclass_fields__ if name != "modules"}
        made = cls(**values, modules={name: config[name].as_dict() for name in MODULES})
        made.check_ranges()
        made.check_encoder()
        return made

    @classmethod
    def read(cls, folder: Path) -> RunConfig:
        """The config of a run folder; keys that its version did not know yet have their defaults.

        Raises:
            ValueError: if it is no run folder, or its config makes no sense.
        """
        kept = read_kept_config(folder)
        if kept is None:
            raise ValueError(
                f"{folder} is not a run folder: it has no config.yaml. Give the folder that `idapt fit` wrote."
            )
        parser = ArgumentParser(exit_on_error=False)
        cls.add_arguments(parser)
        known = {*cls.__dataclass_fields__, *MODULES} - {"modules"}
        entries = {k: v for k, v in without_retired(kept).items() if k in known}
        with blaming(folder / "config.yaml", "Give it the value that the run was started with."):
            config = parser.parse_object(entries | {"run_dir": str(folder)})
            fill_lengths(config.schedule, config.task, config.target)
            return cls.from_namespace(parser.instantiate_classes(config))

    def check_ranges(self) -> None:
        """Numbers that can be right; the other settings check their own when they are made.

        Raises:
            ValueError: naming the first key that is out of its range.
        """
        top = {"seed": SEED, "image_size": IMAGE_SIZE, "frame_stack": Range(1, 64)}
        check_ranges(
            "",
            vars(self),
            top | {"episodes": Range(1, 1e6), "render_processes": Range(0, 256), "threads": Range(1, 1024)},
        )
        for name, ranges in MODULE_RANGES.items():
            check_ranges(name, self.modules[name], ranges)
        steps = {f"schedule.{part}.policy": getattr(self.schedule, part).policy for part in ("pretrain", "finetune")}
        source = length_of(self.schedule.source_policy)
        steps |= {"schedule.source_policy": source, "teacher.dagger": self.teacher.dagger}
        for key, number in steps.items():
            if 0 < number < self.feeding.num_envs:
                raise ValueError(
                    f"{key} is {number} steps for the {self.feeding.num_envs} simulations of feeding.num_envs: "
                    "nothing would be trained. Give at least one step for each, or 0"
                )

    def check_encoder(self) -> None:
        """Only a supervised encoder can be regressed on states before the policy trains; better said before hours of G.

        Raises:
            ValueError: if another one is to be.
        """
        encoder = self.modules["policy"]["encoder"]
        for name in ("pretrain", "finetune"):
            batches = getattr(self.schedule, name).estimator
            if batches and encoder != "supervised":
                raise ValueError(
                    f"schedule.{name}.estimator is {batches} batches, but policy.encoder is {encoder}: "
                    "only a supervised encoder is regressed on states. Set one or the other."
                )
        check_memory(self.modules["policy"]["memory"], self.teacher.rehearse, self.labels.members, self.schedule)
        if self.feeding.garat_start == "matching" and self.schedule.action_transformation and encoder != "supervised":
            raise ValueError(
                f"feeding.garat_start is matching, but policy.encoder is {encoder}: matching needs features that are "
                "states, those of a supervised encoder. Set one or the other."
            )

    @property
    def folder(self) -> Path:
        """The run folder."""
        return Path(self.run_dir or f"runs/{self.task}_{self.target}_{self.seed}")


@dataclass(frozen=True)
class Run:
    """A run that can be trained, resumed, or looked into.

    Attributes:
        config: what it was started with.
        context: what all its stages share.
        aside: starts what the rest of a grounding step does not wait for.
    """

    config: RunConfig
    context: StageContext
    aside: Aside = in_turn

    @classmethod
    def create(cls, config: RunConfig, make_trainer: MakeTrainer = cpu_trainer, aside: Aside = in_turn) -> Run:
        """The run that a config describes; nothing is written yet.

        Args:
            config: of the run.
            make_trainer: stage folder and number of batches to a fresh Trainer.
            aside: starts what the rest of a grounding step does not wait for.

        Raises:
            ValueError: an unknown task or target, or a task whose states the config's settings cannot work with.
        """
        task = make_task(config.task)
        ledger = Ledger(config.folder / "ledger.json")
        processes = usual_processes() if config.render_processes is None else config.render_processes
        worlds = Worlds(
            task, task.domain("source"), task.domain(config.target), ledger,
            config.image_size, config.frame_stack, config.view, processes,
        )  # fmt: skip
        if config.effects.discover or config.labels.members:  # better said before hours of G
            task.motion(np.zeros((1, worlds.dimensions["state_dim"])), 1.0)
        stages, b = Stages(config.folder, config.seed, make_trainer, config.threads), config.feeding
        teacher = Distillation(worlds, stages, config.teacher, b.num_envs, b.policy_batch, b.buffer_size)
        context = StageContext(worlds, stages, module_factories(config), b, teacher, config.filter, config.labels)
        check_modules(context)
        return cls(config, context, aside)

    @classmethod
    def open(cls, folder: Path, make_trainer: MakeTrainer = cpu_trainer) -> Run:
        """The run of a folder, finished or not, its source with the effects that it has found so far.

        Raises:
            ValueError: if it is no run folder.
        """
        run = cls.create(RunConfig.read(folder), make_trainer)
        for path in (path for step in sorted(folder.glob("step_[0-9]*")) for path in effect_files(step)):
            with blaming(path):
                run.worlds.add_effects([effect_from_dict(e) for e in read_json(path)["effects"]])
        return run

    def restore_ledger(self) -> list[str]:
        """Make the ledger say what the run's files hold, if it does not. Returns what was wrong with it.

        Raises:
            ValueError: if a file that holds target interactions cannot be read.
        """
        b, ledger, wrong = self.config.feeding, self.worlds.ledger, []
        lost = "is damaged" if ledger.damaged else "" if ledger.path.exists() else "is missing"

        def real(entries: list[dict]) -> list[dict]:
            # within the lock: what another process has entered by now has its file too
            held, unreadable = held_interactions(self.folder, b.num_envs, b.warmup_steps)
            if unreadable:
                raise ValueError(unreadable[0])
            wrong.extend(disagreements(entries, held))
            return reconciled(entries, held)

        ledger.change(real, restore=True)
        if lost and (wrong or ledger.path.exists()):
            wrong = [f"it {lost}, and is made anew"]
        for told in wrong:
            log.info("%s corrected by the run's files: %s", ledger.path, told)
        return wrong

    @property
    def worlds(self) -> Worlds:
        """Its environments."""
        return self.context.worlds

    @property
    def folder(self) -> Path:
        """Its folder."""
        return self.context.stages.run_dir

    def step_folder(self, k: int) -> Path:
        """Folder of a grounding step."""
        return self.context.stages.folder(k)

    @functools.cached_property
    def evaluation(self) -> Evaluation:
        """What measures it."""
        return Evaluation(self.worlds, self.context.stages, self.config.episodes, self.config.target)

    @functools.cached_property
    def grounding(self) -> IterativeGrounding:
        """Algorithm 1, to be run or resumed."""
        c = self.config
        return IterativeGrounding(self.context, self.evaluation, c.schedule, c.effects, self.aside)

    def load_policy(self, checkpoint: Path) -> AsymmetricSAC:
        """A policy from its checkpoint (weights only, nothing is unpickled)."""
        return load_finished(self.context.new_policy(), checkpoint)

    def load_visual(self, checkpoint: Path | None = None) -> VisualTransformation:
        """G and P^T of a checkpoint, by default of the last grounding step that has them.

        Raises:
            ValueError: if there is none yet.
        """
        made = sorted(self.folder.glob("step_*/visual/final.ckpt"))
        if not made and checkpoint is None:
            raise ValueError(
                f"{self.folder} has no finished visual stage yet; resume it: "
                f"idapt fit --config {self.folder / 'config.yaml'}"
            )
        return load_finished(self.context.make.visual(**self.worlds.dimensions), checkpoint or made[-1])

    def load_estimator(self) -> PixelStatePredictor:
        """What reads states from target images: the newest policy's encoder where that is an estimator, else P^T."""
        G, made = self.load_visual(), sorted(self.folder.glob("step_*/policy/final.ckpt"))
        return self.load_policy(made[-1]).estimator(G) if made else G.estimator


def check_modules(context: StageContext) -> None:
    """Make every module once, without memory for weights, and show it an image: better told before hours of G.

    Raises:
        ValueError: naming the module that cannot be made and why.
    """
    dimensions, bounds = context.worlds.dimensions, context.worlds.action_bounds
    side = context.worlds.image_size
    with torch.device("meta"), torch.no_grad():
        with named("state_predictor"):
            context.make.state_predictor(**dimensions).P_S(torch.empty(2, 3 * context.worlds.frame_stack, side, side))
        with named("visual"):
            G = context.make.visual(**dimensions)
            G.D_T(G.G(torch.empty(2, 3 * G.frames, side, side)))
        with named("policy"):
            pi = context.make.policy(**dimensions, **bounds)
        with named("dynamics"):
            context.make.dynamics(encoder=pi.actor.encoder, **bounds)


@contextmanager
def named(module: str) -> Iterator[None]:
    """Say of which module an error is."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{module}: {error}") from None
    except (RuntimeError, AssertionError) as error:  # torch's words for sizes that do not go together
        raise ValueError(f"{module}: its settings do not suit images of this size ({error})") from None


def module_factories(config: RunConfig) -> ModuleFactories:
    """Constructors of the modules with everything set that a config sets."""
    made: dict[str, Callable] = {name: functools.partial(m, **config.modules[name]) for name, m in MODULES.items()}
    for name in ("state_predictor", "visual", "policy"):
        made[name] = functools.partial(made[name], vision=config.vision)
    return ModuleFactories(**made)
