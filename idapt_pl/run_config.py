"""What a run's config says: one key for each thing there is."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from jsonargparse import ArgumentParser, Namespace

from idapt_pl.effects import View
from idapt_pl.files import blaming
from idapt_pl.image_diagnosis import DiscoverySettings
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, StatePredictor, VisualTransformation
from idapt_pl.modules.ranges import MODULE_RANGES
from idapt_pl.nets.encoder import Vision
from idapt_pl.randomisation import RandomisationSettings
from idapt_pl.ranges import IMAGE_SIZE, SEED, Range, check_ranges
from idapt_pl.run_folder.kept_config import read_kept_config, without_retired
from idapt_pl.stages.distillation import TeacherSettings
from idapt_pl.stages.schedule import Schedule, check_memory, fill_lengths, length_of, policy_steps
from idapt_pl.stages.settings import BatchSettings, FilterSettings, LabelSettings, PoseSettings
from idapt_pl.targets import target_name
from idapt_pl.tasks import SOURCES, TASKS

DIMENSIONS = {"state_dim", "image_size", "frame_stack", "action_low", "action_high", "rates", "dt", "vision"}
"""Constructor arguments that the task and the data determine, never typed in a config."""

MODULES: dict[str, type] = {
    "state_predictor": StatePredictor,
    "visual": VisualTransformation,
    "dynamics": ActionTransformation,
    "policy": AsymmetricSAC,
}
"""What is learned, by its key in a config."""

METHOD_NAMES = ("idapt", "source", "oracle", "cc_state", "cc_image")
"""What ``idapt fit`` can run (:mod:`idapt_pl.baselines.methods`)."""

SETTINGS: dict[str, type] = {
    "view": View,
    "schedule": Schedule,
    "effects": DiscoverySettings,
    "feeding": BatchSettings,
    "randomisation": RandomisationSettings,
    "teacher": TeacherSettings,
    "filter": FilterSettings,
    "labels": LabelSettings,
    "poses": PoseSettings,
    "vision": Vision,
}
"""Everything else that a config sets, by its key."""


@dataclass(frozen=True)
class RunConfig:
    """One config key for each thing there is.

    Attributes:
        task: name of the task.
        task_options: of the constructor of a task that is not one of ours.
        target: name of the target domain, or what else it is (:mod:`idapt_pl.targets`).
        method: what is run: :data:`METHOD_NAMES`.
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
        randomisation: what policies train in, if that is not the source as it is.
        filter: how the policy's filter learns, if it has one.
        labels: how images of the target get states to learn from, if they do.
        poses: in which poses beside those of motions the source is seen.
        vision: how images are looked at.
        modules: constructor arguments of each of :data:`MODULES`.
    """

    task: str
    task_options: dict[str, Any]
    target: str | dict[str, Any]
    method: str
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
    randomisation: RandomisationSettings
    teacher: TeacherSettings
    filter: FilterSettings
    labels: LabelSettings
    poses: PoseSettings
    vision: Vision
    modules: dict[str, dict[str, Any]]

    @staticmethod
    def add_arguments(parser: ArgumentParser) -> None:
        """Give a parser an option for every key."""
        parser.add_argument("--seed", type=int, default=0, help="root seed; every stage derives its own")
        parser.add_argument("--run_dir", type=str, default=None, help="run folder; default runs/<task>_<target>_<seed>")
        parser.add_argument(
            "--task", type=str, default="inverted_pendulum", help=f"one of: {', '.join(TASKS)}; {SOURCES}"
        )
        parser.add_argument(
            "--task_options",
            type=dict[str, Any],
            default={},
            help="of a task that is none of these: action_repeat, camera, expert_steps, and what its constructor takes",
        )
        parser.add_argument(
            "--target",
            type=dict[str, Any] | str,
            default="hard",
            help="target domain, easy or hard; or {env: MODULE:NAME}, {task: TASK} with what the guide says of them",
        )
        parser.add_argument(
            "--method",
            type=Literal[METHOD_NAMES],
            default="idapt",
            help="Algorithm 1 (idapt), or a baseline with its settings: a policy of the source alone, randomised where "
            "--randomisation says so (source), or of the target with its reward (oracle), or a policy of the source on "
            "what is read of the target's images (cc_state) or on the images translated back (cc_image)",
        )
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
            "two processes, with the same results where --threads is 1; default where there are two cores and no GPU",
        )
        parser.add_class_arguments(View, "view")
        parser.add_argument("--frame_stack", type=int, default=3, help="frames in an observation")
        parser.add_argument("--episodes", type=int, default=20, help="episodes for each reported return")
        parser.add_argument("--oracle", type=bool, default=False, help="also train the oracle reference in the target")
        add_shorten(parser)
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
        made.check_contradictions()
        made.check_recurrence()
        made.check_oracle()
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

    def check_recurrence(self) -> None:
        """A recurrent policy learns by SAC alone, in the source.

        Raises:
            ValueError: if it is to do something else.
        """
        policy = self.modules["policy"]
        if policy["recurrent"] and (self.method != "source" or self.teacher.steps or policy["memory"]):
            raise ValueError(
                f"policy.recurrent is {policy['recurrent']}, for policies that SAC trains in the source: set method: "
                "source, teacher.steps: 0 and policy.memory: 0, as configs/presets/adaptive_rl.yaml does, or "
                "policy.recurrent: 0"
            )

    def check_oracle(self) -> None:
        """The oracle trains for as long as the run's policies do by SAC.

        Raises:
            ValueError: if that is not at all.
        """
        if (self.oracle or self.method == "oracle") and not policy_steps(self.schedule):
            raise ValueError(
                "the oracle trains by SAC for as long as the run's policies do, and they do not: "
                "schedule.source_policy, schedule.pretrain.policy and schedule.finetune.policy are 0. Train it in a "
                "run of its own with --config configs/presets/oracle.yaml, which says how long; `python "
                "benchmarks/bounds.py` trains one on states"
            )

    def check_contradictions(self) -> None:
        """See that settings do not exclude each other, which is better said before hours of G.

        Raises:
            ValueError: naming two that do.
        """
        encoder = self.modules["policy"]["encoder"]
        for name in ("pretrain", "finetune"):
            batches = getattr(self.schedule, name).estimator
            if batches and encoder != "supervised":
                raise ValueError(
                    f"schedule.{name}.estimator is {batches} batches, but policy.encoder is {encoder}: "
                    "only a supervised encoder is regressed on states. Set one or the other."
                )
        policy, labels = self.modules["policy"], self.labels
        check_memory(policy["memory"], self.teacher.rehearse, labels.members, labels.replays, self.schedule)
        learns = encoder == "supervised" and (policy["estimator_updates"] or self.schedule.pretrain.estimator)
        if labels.replays and not learns:
            raise ValueError(
                f"labels.replays is {labels.replays}, but policy.encoder is {encoder}, policy.estimator_updates "
                f"{policy['estimator_updates']} and schedule.pretrain.estimator {self.schedule.pretrain.estimator}: "
                "nothing learns from labels. Give supervised and one of these, or set labels.replays to 0."
            )
        if self.schedule.paired_steps and not self.modules["visual"]["reset_weight"]:
            raise ValueError(
                f"schedule.paired_steps is {self.schedule.paired_steps}, but G learns nothing from pairs, as "
                "visual.reset_weight is 0. Set one or the other."
            )
        learns_F = self.method == "idapt" and self.schedule.action_transformation and self.schedule.grounding_steps
        if learns_F and not self.schedule.finetune.dynamics:
            raise ValueError(
                "schedule.finetune.dynamics is 0 rollouts, but schedule.action_transformation is true: F would be used "
                "untrained. Give rollouts, such as 10, or schedule.action_transformation: false."
            )
        if self.feeding.garat_start == "matching" and self.schedule.action_transformation and encoder != "supervised":
            raise ValueError(
                f"feeding.garat_start is matching, but policy.encoder is {encoder}: matching needs features that are "
                "states, those of a supervised encoder. Set one or the other."
            )

    @property
    def folder(self) -> Path:
        """The run folder."""
        return Path(self.run_dir or usual_folder(self.task, self.target, self.seed))


def add_shorten(parser: ArgumentParser) -> None:
    """Give a parser the option that makes a run short; numbers say it all once it is parsed."""
    parser.add_argument(
        "--shorten",
        type=float,
        default=1.0,
        help="divide all lengths by this, such as 50, and take one grounding step: every stage in minutes, to see "
        "whether everything works; what it learns is worth nothing. Its run folder ends with _short",
    )


def usual_folder(task: str, target: str | dict[str, Any], seed: int) -> str:
    """The run folder where none is given."""
    return f"runs/{in_file_names(task)}_{in_file_names(target_name(target))}_{seed}"


def in_file_names(name: str) -> str:
    """A name with nothing in it that a folder's name should not have."""
    return re.sub(r"[^\w.-]+", "-", name)
