"""The runs of a sweep, each with its complete config, checked before anything runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from idapt_pl.files import read_yaml
from idapt_pl.run_config import in_file_names
from idapt_pl.run_folder.kept_config import changed_keys
from idapt_pl.sweep.folder import SweepFolder
from idapt_pl.sweep.settings import SweepSettings, Variant, config_file
from idapt_pl.targets import target_name

Complete = Callable[[list[str]], dict[str, Any]]
"""Arguments of ``idapt fit`` to the complete config that they make, once it is known that a run can begin with it."""


@dataclass(frozen=True)
class PlannedRun:
    """One row of a sweep.

    Attributes:
        index: from 0 on, in the order of the YAML.
        name: of its folder.
        label: what the YAML calls the task and config.
        task, target: of its config.
        method: what the YAML calls it.
        seed: root seed.
        digest: of the arguments and files that its config was made of.
    """

    index: int
    name: str
    label: str
    task: str
    target: str
    method: str
    seed: int
    digest: str = ""

    @property
    def cell(self) -> str:
        """What is compared within: the task as the YAML calls it, and the target."""
        return f"{self.label}/{self.target}"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def plan_sweep(
    settings: SweepSettings, folder: SweepFolder, complete: Complete, only: int | None = None, write: bool = True
) -> list[PlannedRun]:
    """Make the runs of a sweep and their configs; nothing is written if anything is wrong.

    Configs of an earlier call that were made of the same settings are taken as they are.

    Args:
        settings: of the sweep.
        folder: of the sweep.
        complete: makes a config complete.
        only: the one run whose config is wanted; None for all.
        write: whether to write configs and the plan.

    Raises:
        ValueError: an unknown task, method, key or file, settings that a run cannot begin with, or a run that was begun
            with other settings.
    """
    known = {run.name: run for run in folder.read_plan()}
    runs: list[PlannedRun] = []
    configs: dict[str, dict[str, Any]] = {}
    for label, target, method, arguments, where in combinations(settings):
        digest = digest_of(arguments)
        made: dict[str, Any] | None = None
        for seed in settings.seeds:
            index = len(runs)
            name = in_file_names("_".join(filter(None, (label, target, method, str(seed)))))
            before = known.get(name)
            if before is not None and before.digest == digest and folder.config(name).is_file():
                runs.append(PlannedRun(**before.to_dict() | {"index": index}))
                continue
            if made is None and only in (None, index):
                made = completed(complete, arguments, where)
            task, there = (str(made["task"]), target_name(made["target"])) if made else (label, target)
            runs.append(PlannedRun(index, name, label, task, there, method, seed, digest if made else ""))
            if made is not None:
                configs[name] = made | {"seed": seed}
    refuse_clashes(runs, configs, folder)
    if only is not None and not 0 <= only < len(runs):
        raise ValueError(f"--index {only}: the sweep has runs 0 to {len(runs) - 1}")
    if write:
        for name, config in configs.items():
            folder.write_config(name, config)
        if only is None and [r.to_dict() for r in runs] != [r.to_dict() for r in known.values()]:
            folder.write_plan(runs)
    return runs


def combinations(settings: SweepSettings) -> Iterator[tuple[str, str, str, list[str], str]]:
    """Task, target, method, arguments without the seed, and what to call it in an error."""
    for label, configs in settings.tasks.items():
        for target, said in settings.targets.items():
            if not target and any("{target}" in name for name in configs):
                raise ValueError(f"tasks: {label}: {configs[0]} needs targets, such as targets: [easy, hard]")
            base = [str(config_file(name, target, f"tasks: {label}")) for name in configs]
            for method, laid in settings.methods.items():
                where = f"methods: {method}, on {label}" + f" to {target}" * bool(target)
                arguments = [f"--config={path}" for path in base]
                aim = [] if said is None else [f"--target={yaml.safe_dump(said, default_flow_style=True).strip()}"]
                if isinstance(said, str):
                    aim = [f"--target={said}"]
                for over in (settings.overrides, laid):
                    arguments += laid_over(over, target, where)
                yield label, target, method, arguments + aim, where


def laid_over(over: Variant, target: str, where: str) -> list[str]:
    """A variant as arguments."""
    arguments = [f"--config={config_file(name, target, where)}" for name in over.configs]
    return arguments + ([f"--config={yaml.safe_dump(over.entries)}"] if over.entries else [])


def completed(complete: Complete, arguments: list[str], where: str) -> dict[str, Any]:
    """The complete config.

    Raises:
        ValueError: saying which method, task and target cannot be.
    """
    try:
        return complete(arguments)
    except Exception as error:  # of the parser, of a task, of a module: all are the config's
        raise ValueError(f"{where}: {' '.join(str(error).split())[:400]}") from error


def digest_of(arguments: Sequence[str]) -> str:
    """SHA-256 of arguments and the files that they and their configs name, such as ranges or known effects."""
    found = hashlib.sha256()
    for argument in arguments:
        key, _, value = argument.partition("=")
        found.update(argument.encode())
        if key == "--config":
            said = yaml.safe_load(value) if "\n" in value else read_yaml(Path(value))
            found.update(json.dumps(said, sort_keys=True, default=str).encode())
            for path in named_files(said):
                found.update(path.read_bytes())
    return found.hexdigest()[:16]


def named_files(said: Any) -> Iterator[Path]:
    """Files that values of a config name, in order."""
    if isinstance(said, dict | list):
        for value in said.values() if isinstance(said, dict) else said:
            yield from named_files(value)
    elif isinstance(said, str) and Path(said).suffix and len(said) < 500 and Path(said).is_file():
        yield Path(said)


def refuse_clashes(runs: Sequence[PlannedRun], configs: dict[str, dict[str, Any]], folder: SweepFolder) -> None:
    """Two runs cannot be one, and a run that was begun keeps its settings.

    Raises:
        ValueError: naming the run and the keys that differ.
    """
    names = [run.name for run in runs]
    if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        raise ValueError(f"two runs would be called {twice[0]}; give tasks, targets or methods other names")
    for name, config in configs.items():
        kept = folder.begun_config(name)
        if kept is not None and (different := changed_keys(kept, json.loads(json.dumps(config)))):
            raise ValueError(
                f"{name} was begun with other settings ({', '.join(different[:5])} differ): name another folder, or "
                f"remove {folder.run(name)} to begin it anew"
            )
