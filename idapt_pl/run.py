"""A run: what its config says, and what its folder holds. Made by ``idapt fit``, opened by everything else."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from idapt_pl.baselines.methods import METHODS, Method
from idapt_pl.effects import Domain, effect_from_dict
from idapt_pl.envs.ledger import Ledger
from idapt_pl.evaluation.evaluation import Evaluation
from idapt_pl.files import blaming, read_json
from idapt_pl.grounding import IterativeGrounding
from idapt_pl.image_diagnosis import known_effects
from idapt_pl.modules import AsymmetricSAC, RecurrentSAC, VisualTransformation
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.randomisation import FOUND
from idapt_pl.rendering.parallel import usual_processes
from idapt_pl.run_config import MODULES, RunConfig
from idapt_pl.run_folder.interactions import disagreements, held_interactions, reconciled
from idapt_pl.run_folder.results import effect_files, newest_of, step_of
from idapt_pl.stage import MakeTrainer, Stages, cpu_trainer, load_finished
from idapt_pl.stages.aside import Aside, in_turn
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.distillation import Distillation
from idapt_pl.stages.schedule import Schedule, length_of
from idapt_pl.stages.settings import ModuleFactories
from idapt_pl.targets import RecordedTarget, Target, make_target, target_name
from idapt_pl.tasks import make_task
from idapt_pl.worlds import Worlds

log = logging.getLogger(__name__)


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
        task = make_task(config.task, config.task_options)
        ledger, known = Ledger(config.folder / "ledger.json"), known_effects(config.effects.known, task)
        processes = usual_processes() if config.render_processes is None else config.render_processes
        worlds = Worlds(
            task, task.domain("source"), make_target(config.target, task), ledger,
            config.image_size, config.frame_stack, config.view, processes, config.randomisation.distribution(task.name),
            config.randomisation.variants, config.seed, known,
        )  # fmt: skip
        worlds.add_effects(known)
        check_randomisation(config, worlds)
        check_exploration(config, worlds)
        if config.labels.members:  # better said before hours of G
            task.motion(np.zeros((1, worlds.dimensions["state_dim"])), 1.0)
        if (config.oracle or config.method == "oracle") and not worlds.target.has_states:
            raise ValueError(f"oracle: it would train on the states of {worlds.target.name}, which are not known")
        if config.method == "idapt":
            check_recordings(worlds.target, config.schedule)
        stages, b = Stages(config.folder, config.seed, make_trainer, config.threads), config.feeding
        if worlds.target.alone and worlds.target.measured:  # what is set aside plays it too
            aside = in_turn
        settings = config.teacher if config.method == "idapt" else config.teacher.in_the_source()
        teacher = Distillation(worlds, stages, settings, b.num_envs, b.policy_batch, b.buffer_size, aside)
        factories = module_factories(config)
        context = StageContext(worlds, stages, factories, b, teacher, config.filter, config.labels, config.poses)
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

    @property
    def plain_source(self) -> Domain:
        """The source that the policy of direct transfer trains in: what is found of its physics is not in it."""
        looks = self.folder / "step_00/looks.json"
        found = read_json(looks)["effects"] if looks.exists() else []
        return self.worlds.first_source.with_effects(*map(effect_from_dict, found))

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

    @property
    def recorded(self) -> set[int]:
        """Grounding steps whose recordings of the target it has."""
        steps = (step_of(path.parent) for path in self.folder.glob("step_*/target.h5"))
        return {k for k in steps if k is not None}

    @functools.cached_property
    def evaluation(self) -> Evaluation:
        """What measures it."""
        c = self.config
        return Evaluation(self.worlds, self.context.stages, c.episodes, target_name(c.target), c.method)

    @functools.cached_property
    def grounding(self) -> IterativeGrounding:
        """Algorithm 1, to be run or resumed."""
        c = self.config
        found = c.randomisation.ranges == FOUND
        return IterativeGrounding(self.context, self.evaluation, c.schedule, c.effects, self.aside, found)

    @property
    def method(self) -> Method:
        """What the config asks for: Algorithm 1, or a baseline with its settings."""
        return METHODS[self.config.method](self.grounding)

    def load_policy(self, checkpoint: Path) -> AsymmetricSAC:
        """A policy from its checkpoint (weights only, nothing is unpickled)."""
        return load_finished(self.context.new_policy(), checkpoint)

    def load_visual(self, checkpoint: Path | None = None) -> VisualTransformation:
        """G and P^T of a checkpoint, by default of the last grounding step that has them.

        Raises:
            ValueError: if there is none yet.
        """
        made = [newest_of(f, "visual/final.ckpt") for f in sorted(self.folder.glob("step_*"))]
        made = [path for path in made if path.exists()]
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


def check_randomisation(config: RunConfig, worlds: Worlds) -> None:
    """Whether what is drawn fits the source, and whether there will be intervals to draw from.

    Raises:
        ValueError: saying what does not.
    """
    ranges = config.randomisation.ranges
    if ranges == FOUND and not (config.effects.discover and config.method == "idapt"):
        raise ValueError(
            "randomisation.ranges is found, but this run finds no effects: set effects.discover: true and method: "
            "idapt, or give other ranges"
        )
    try:
        worlds.distribution.check(worlds.source_domain)
    except ValueError as error:
        where = ranges if isinstance(ranges, str) else "as given"
        raise ValueError(f"randomisation.ranges ({where}) do not suit {worlds.task.name}: {error}") from None


def check_exploration(config: RunConfig, worlds: Worlds) -> None:
    """Whether there can be a policy that explores.

    Raises:
        ValueError: saying why not.
    """
    kinds = (config.schedule.exploration or "").split("+")
    if "rehearse" in kinds and not config.teacher.steps:
        raise ValueError(
            "schedule.exploration: rehearse plays what a teacher does in the source, and there is none: give "
            "teacher.steps and teacher.rehearse (or dagger), or explore by babble or random"
        )
    if "backwards" in kinds:
        worlds.task.backwards()
    if {"backwards", "expert"} & set(kinds) and not worlds.target.has_states and config.method != "source":
        raise ValueError(
            f"schedule.exploration: {config.schedule.exploration} acts on true states, which {worlds.target.name} does "
            "not show. Drive it yourself and give target.recordings, or explore by babble or random"
        )


def check_recordings(target: Target, schedule: Schedule) -> None:
    """A target that is known from recordings alone needs one for each grounding step.

    Raises:
        ValueError: if there are fewer.
    """
    if isinstance(target, RecordedTarget) and target.inbox is None:
        there, needed = len(target.files), 1 + length_of(schedule.grounding_steps)
        if there < needed:
            raise ValueError(
                f"target.recordings has {there}, but schedule.grounding_steps {needed - 1} needs {needed}: one for "
                f"step 0 and one for each step after it. Give more, or schedule.grounding_steps: {there - 1}"
            )


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
    if config.modules["policy"]["recurrent"]:
        made["policy"] = functools.partial(RecurrentSAC, **config.modules["policy"], vision=config.vision)
    return ModuleFactories(**made)
