"""What a sweep's YAML says, checked key by key."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from idapt_pl.files import read_yaml
from idapt_pl.ranges import SEED
from idapt_pl.run_folder.shipped_configs import ABOVE
from idapt_pl.targets import target_name
from idapt_pl.tasks import TASKS

CONFIG_NAMES = {
    "inverted_pendulum": "pendulum",
    "half_cheetah": "cheetah",
    "walker2d": "walker",
    "fetch_reach": "fetch",
    "sawyer_push": "sawyer",
}
"""What files in ``configs/`` call our tasks."""

SIZES = {"quick": "quick", "full": "{target}"}
"""How the configs of our tasks are called, by ``size``."""


@dataclass(frozen=True)
class RunResources:
    """What each run gets for itself.

    Attributes:
        cpus: cores; a run computes with as many threads.
        gpus: graphics cards; 0.5 for two runs on one.
    """

    cpus: int = 1
    gpus: float = 0.0


@dataclass(frozen=True)
class Variant:
    """Settings laid over a base config: a method, or what all runs have.

    Attributes:
        configs: files, each laid over those before.
        entries: nested keys and values of ``idapt fit``, over the files.
    """

    configs: tuple[str, ...] = ()
    entries: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SweepSettings:
    """A sweep.

    Attributes:
        folder: where everything goes.
        tasks: name to base configs, in whose names ``{target}`` stands for that of the target.
        targets: name to what ``idapt fit --target`` takes; ``{"": None}`` for the configs' own.
        methods: name to what is laid over the base config.
        seeds: root seeds.
        overrides: what is laid over all runs.
        resources: of each run.
        retries: how often a run that failed is tried again.
        storage: where runs are kept between stages if nodes share no file system; None where they do.
        normalise: what a score of 1 is, ``oracle`` or ``paper``.
        references: cell, as ``task/target``, to ``direct_transfer`` and ``oracle`` measured elsewhere.
    """

    folder: Path
    tasks: dict[str, tuple[str, ...]]
    targets: dict[str, Any]
    methods: dict[str, Variant]
    seeds: tuple[int, ...]
    overrides: Variant = Variant()
    resources: RunResources = RunResources()
    retries: int = 1
    storage: str | None = None
    normalise: str = "oracle"
    references: dict[str, dict[str, float]] = field(default_factory=dict)


SWEEP_KEYS = {*SweepSettings.__dataclass_fields__, "size"}


def read_sweep(path: Path, folder: Path | None = None) -> SweepSettings:
    """The sweep that a YAML describes.

    Args:
        path: of the YAML.
        folder: in place of its ``folder``.

    Raises:
        ValueError: naming the file, the key, what was expected and what came.
    """
    said = read_yaml(path)
    try:
        if not isinstance(said, dict):
            raise ValueError(f"it holds no keys and values; a sweep has {', '.join(sorted(SWEEP_KEYS))}")
        return settings_from(said, folder or Path(said.get("folder") or Path("runs/sweeps") / path.stem))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def settings_from(said: Mapping[str, Any], folder: Path) -> SweepSettings:
    """The sweep of a YAML's content.

    Raises:
        ValueError: naming the key that cannot be right.
    """
    known(said, SWEEP_KEYS, "a sweep")
    targets = named_targets(said.get("targets"))
    overrides = variant(said.get("overrides"), "overrides")
    r = mapping(said.get("resources"), "resources")
    known(r, RunResources.__dataclass_fields__, "resources")
    tasks = base_configs(said.get("tasks"), said.get("size", "full"))
    references = measured_elsewhere(said.get("references"))
    if isinstance(said.get("references"), dict):  # a table may have more cells than a sweep
        refuse_unknown_cells(references, tasks, targets)
    retries, normalise = said.get("retries", 1), said.get("normalise", "oracle")
    if normalise not in ("oracle", "paper"):
        raise ValueError(f"normalise is {normalise!r}, expected oracle or paper: what a score of 1 is")
    if not isinstance(said.get("storage"), str | None):
        raise ValueError(f"storage is {said['storage']!r}, expected a folder or an address such as s3://bucket/sweep")
    return SweepSettings(
        folder=folder,
        tasks=tasks,
        targets=targets,
        methods={name: variant(v, f"methods: {name}") for name, v in named_methods(said.get("methods")).items()},
        seeds=root_seeds(said.get("seeds")),
        overrides=overrides,
        resources=RunResources(
            cpus=int(number(r.get("cpus", 1), "resources.cpus", 1, 1024, whole=True)),
            gpus=number(r.get("gpus", 0), "resources.gpus", 0, 64),
        ),
        retries=int(number(retries, "retries", 0, 100, whole=True)),
        storage=said.get("storage"),
        normalise=normalise,
        references=references,
    )


# --- one function for each key --------------------------------------------------------------------------


def base_configs(said: Any, size: Any) -> dict[str, tuple[str, ...]]:
    """``tasks``: a list of tasks and config files, or names with their config files.

    Raises:
        ValueError: if there is none, or a name is no task.
    """
    if size not in SIZES:
        raise ValueError(f"size is {size!r}, expected one of: {', '.join(SIZES)}")
    if not said or not isinstance(said, list | dict):
        raise ValueError("tasks: expected a list of tasks or config files, such as [inverted_pendulum]")
    if isinstance(said, dict):
        return {str(name): files(v, f"tasks: {name}") for name, v in said.items()}
    found: dict[str, tuple[str, ...]] = {}
    for entry in said:
        if entry in TASKS:
            name, config = str(entry), f"configs/{CONFIG_NAMES[entry]}_{SIZES[size]}.yaml"
        elif isinstance(entry, str) and entry.endswith((".yaml", ".yml")):
            name, config = Path(entry).stem.replace("_{target}", ""), entry
        else:
            raise ValueError(f"tasks: unknown task {entry!r}; known: {', '.join(TASKS)}, or the file of a config")
        if name in found:
            raise ValueError(f"tasks: {name} stands twice; give names, as in {{{name}_a: {entry}}}")
        found[name] = (config,)
    return found


def named_targets(said: Any) -> dict[str, Any]:
    """``targets``: a list of domains, or names with what ``--target`` takes.

    Raises:
        ValueError: if it is something else.
    """
    if said is None:
        return {"": None}
    if isinstance(said, dict) and said:
        named = {str(name): v for name, v in said.items()}
    elif isinstance(said, list) and said:
        named = {target_name(v) if isinstance(v, str | dict) else str(v): v for v in said}
        if len(named) < len(said):
            raise ValueError("targets: two have one name; give names, as in {slow: {env: ...}, fast: {env: ...}}")
    else:
        raise ValueError(f"targets is {said!r}, expected a list such as [easy, hard], or names with their settings")
    for name, v in named.items():
        if not isinstance(v, str | dict):
            raise ValueError(f"targets: {name} is {v!r}, expected a domain such as hard, or keys such as {{env: ...}}")
    return named


def named_methods(said: Any) -> dict[str, Any]:
    """``methods``: names with settings; without any, the configs as they are.

    Raises:
        ValueError: if it is something else.
    """
    if said is None:
        return {"IDAPT": None}
    if isinstance(said, list):
        unknown = [str(name) for name in said if name != "IDAPT"]
        if unknown or not said:
            raise ValueError(
                f"methods: unknown method {', '.join(unknown) or said}; a list may name IDAPT alone, the configs as "
                "they are. Give others their settings, as in {no F: {schedule.action_transformation: false}}"
            )
        return {"IDAPT": None}
    if not isinstance(said, dict) or not said:
        raise ValueError(f"methods is {said!r}, expected names with settings, as in {{IDAPT: {{}}}}")
    return {str(name): v for name, v in said.items()}


def variant(said: Any, where: str) -> Variant:
    """Settings as keys and values (dotted or nested; ``config`` for files under them), or as the file of a preset.

    Raises:
        ValueError: if they are something else, or a file is missing.
    """
    if isinstance(said, str | list):
        return Variant(files(said, where))
    entries = dict(mapping(said, where))
    configs = files(entries.pop("config"), f"{where}: config") if entries.get("config") else ()
    for key in ("seed", "run_dir", "config"):
        if key in entries:
            raise ValueError(f"{where}: {key} is not set by a method; the sweep gives each run its own")
    return Variant(configs, nested(entries, where))


def nested(entries: Mapping[str, Any], where: str) -> dict[str, Any]:
    """``{a.b: 1}`` as ``{a: {b: 1}}``.

    Raises:
        ValueError: if a key is set twice.
    """
    found: dict[str, Any] = {}
    for key, value in entries.items():
        *parents, last = str(key).split(".")
        inside = found
        for parent in parents:
            inside = inside.setdefault(parent, {})
            if not isinstance(inside, dict):
                raise ValueError(f"{where}: {key} is below a key that has a value already")
        if last in inside and isinstance(inside[last], dict) and isinstance(value, dict):
            inside[last] |= value
        elif last in inside:
            raise ValueError(f"{where}: {key} is set twice")
        else:
            inside[last] = dict(value) if isinstance(value, dict) else value
    return found


def root_seeds(said: Any) -> tuple[int, ...]:
    """``seeds``: a list of numbers, each once.

    Raises:
        ValueError: if it is something else.
    """
    right = isinstance(said, list) and said and all(isinstance(s, int) and not isinstance(s, bool) for s in said)
    if not right or min(said) < 0 or max(said) > SEED.high or len(set(said)) < len(said):
        raise ValueError(f"seeds is {said!r}, expected a list of whole numbers from 0 on, each once, such as [0, 1, 2]")
    return tuple(said)


def measured_elsewhere(said: Any) -> dict[str, dict[str, float]]:
    """``references``: for a cell, returns measured elsewhere; or a table of them.

    Raises:
        ValueError: if it is something else.
    """
    if isinstance(said, str):
        return tabled_oracles(config_file(said, "", "references"))
    found = {}
    for cell, entries in mapping(said, "references").items():
        where = f"references: {cell}"
        known(mapping(entries, where), ("direct_transfer", "oracle"), where)
        if "/" not in str(cell):
            raise ValueError(f"{where}: expected a task and a target, as in inverted_pendulum/hard")
        found[str(cell)] = {str(k): number(v, f"{where}.{k}", -1e9, 1e9) for k, v in entries.items()}
    return found


def refuse_unknown_cells(
    references: Mapping[str, Any], tasks: Mapping[str, Sequence[str]], targets: Mapping[str, Any]
) -> None:
    """References must be of cells that the sweep has; a name may be the sweep's or the task's own.

    Raises:
        ValueError: naming the first that is none.
    """
    for cell in references:
        task, _, target = cell.partition("/")
        if (task not in tasks and task not in TASKS) or ("" not in targets and target not in targets):
            cells = ", ".join(f"{t}/{d or 'TARGET'}" for t in tasks for d in targets)
            raise ValueError(f"references: {cell} is no cell of this sweep; it has {cells}")


def tabled_oracles(path: Path) -> dict[str, dict[str, float]]:
    """Oracles of a CSV file as ``benchmarks/bounds.py`` writes it: means over rows of one task and domain.

    Raises:
        ValueError: if columns are missing.
    """
    with path.open(newline="", encoding="utf-8") as f:
        rows = list(csv.DictReader(f))
    try:
        oracles = [row for row in rows if row["policy"] == "oracle"]
        by_success = {row["task"] for row in oracles if row["metric"] == "success"}
        values: dict[str, list[float]] = {}
        for row in oracles:
            if row["metric"] == ("success" if row["task"] in by_success else "return"):
                values.setdefault(f"{row['task']}/{row['domain']}", []).append(float(row["mean"]))
    except (KeyError, ValueError) as error:
        raise ValueError(
            f"references: {path} is no table of oracles ({error}); it has task, domain, policy, metric and mean"
        ) from None
    return {cell: {"oracle": sum(found) / len(found)} for cell, found in values.items()}


# --- what the functions above share ---------------------------------------------------------------------


def known(said: Mapping[str, Any], keys: Iterable[str], what: str) -> None:
    """Refuse keys that mean nothing.

    Raises:
        ValueError: naming them and those there are.
    """
    if unknown := [str(k) for k in said if k not in set(keys)]:
        raise ValueError(f"unknown key {', '.join(unknown)}; {what} has {', '.join(sorted(keys))}")


def mapping(said: Any, where: str) -> dict[str, Any]:
    """Keys and values; none if nothing was said.

    Raises:
        ValueError: if it is something else.
    """
    if said is None:
        return {}
    if not isinstance(said, dict):
        raise ValueError(f"{where}: expected keys and values, got {said!r}")
    return said


def number(said: Any, where: str, low: float, high: float, whole: bool = False) -> float:
    """A number in its range.

    Raises:
        ValueError: if it is none.
    """
    right = isinstance(said, int) if whole else isinstance(said, int | float)
    if not right or isinstance(said, bool) or not low <= said <= high:
        kind = "a whole number" if whole else "a number"
        raise ValueError(f"{where} is {said!r}, expected {kind} from {low:g} to {high:g}")
    return float(said)


def files(said: Any, where: str) -> tuple[str, ...]:
    """Names of files, one or several.

    Raises:
        ValueError: if it is something else.
    """
    names = said if isinstance(said, list) else [said]
    if not names or not all(isinstance(n, str) and n for n in names):
        raise ValueError(f"{where}: expected the file of a config, or a list of them, got {said!r}")
    return tuple(names)


def config_file(name: str, target: str, where: str) -> Path:
    """The file of a config: from here, or from where the package is.

    Raises:
        ValueError: if there is none.
    """
    told = name.replace("{target}", target)
    for path in (Path(told), ABOVE / told):
        if path.is_file():
            return path
    raise ValueError(f"{where}: there is no file {told}; names of files are relative to the folder you are in")
