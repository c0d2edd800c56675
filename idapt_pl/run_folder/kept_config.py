"""The config that a run folder keeps: ``config.yaml``, and its copy in ``run.json``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from idapt_pl.files import DamagedFile, read_json, read_yaml, write_yaml

CHANGE_NOTHING = {
    "config", "run_dir", "trainer", "oracle", "ckpt_path", "weights_only", "predictions", "quality", "workers",
    "render_processes", "threads", "side_by_side",
}  # fmt: skip
"""Keys that may differ in a resumed run; the folder may have been moved."""

HOW_IT_IS_REACHED = {
    "target.attended", "target.patience", "target.measure", "target.recordings", "target.by_hand",
    "target.options.host", "target.options.port", "target.options.seconds",
}  # fmt: skip
"""Likewise: how long is waited for a robot and where it is found; where recordings lie that were not read yet."""

RETIRED: dict[str, dict[str, Any]] = {
    "policy": {"estimator_jitter": 0.0},
    "schedule": {"source_actions": "policy"},
    "teacher": {"source_candidates": 1},
}
"""Keys that older configs have, and the value at which leaving them out changes nothing."""


def is_run_folder(folder: Path) -> bool:
    """Whether a run was begun in a folder."""
    return (folder / "run.json").exists() or (folder / "step_00").is_dir()


def read_run_json(folder: Path) -> dict:
    """What ``run.json`` says; empty if it is not there.

    Raises:
        DamagedFile: if it cannot be read.
    """
    path = folder / "run.json"
    cure = "Delete it: then it is not known any more when and by which versions the run was made; all else stays."
    return read_json(path, cure=cure) if path.exists() else {}


def shortened_by(folder: Path) -> float:
    """What the lengths of a run were divided by when it was started; 1 where its ``run.json`` says nothing of it.

    Raises:
        DamagedFile: if it cannot be read.
    """
    return read_run_json(folder).get("shortened_by", 1.0)


def read_kept_config(folder: Path) -> dict | None:
    """The config of a run folder; a lost ``config.yaml`` comes back from ``run.json``. None if there is neither.

    Raises:
        DamagedFile: if a file cannot be read, or they disagree.
    """
    path, noted = folder / "config.yaml", read_run_json(folder).get("config")
    cure = "Delete it, and it comes back from run.json."
    if not path.exists():
        if noted is not None:
            write_yaml(path, noted)
        return noted
    if noted is None:
        cure = "Put back the config that the run was started with."
    try:
        config = read_yaml(path)
    except ValueError as error:
        raise DamagedFile(f"{error}. {cure}") from None
    if not isinstance(config, dict):
        raise DamagedFile(f"{path}: holds no config. {cure}")
    noted = noted or {}
    if different := lost_keys(noted, config) + changed_keys(filled(noted, config), config):
        raise DamagedFile(
            f"{path}: is not the config that the run was started with ({', '.join(dict.fromkeys(different))} differ). "
            f"{cure}"
        )
    return config


def without_retired(entries: dict[str, Any]) -> dict[str, Any]:
    """A config without keys that are gone, unless they say something; then the parser names them."""
    kept = dict(entries)
    for name, keys in RETIRED.items():
        if isinstance(kept.get(name), dict):
            kept[name] = {k: v for k, v in kept[name].items() if k not in keys or v != keys[k]}
    return kept


def filled(config: dict, defaults: dict) -> dict:
    """A config with the defaults of keys that it does not have: it may be of a version that did not know them yet."""
    nested = {
        k: filled(config[k], v) for k, v in defaults.items() if isinstance(v, dict) and isinstance(config.get(k), dict)
    }
    return defaults | config | nested


def lost_keys(old: dict, new: dict, prefix: str = "") -> list[str]:
    """Dotted keys that a config does not have any more, whatever they change."""
    keys = [f"{prefix}{key}" for key in old if key not in new]
    nested = [k for k, v in old.items() if isinstance(v, dict) and isinstance(new.get(k), dict)]
    return keys + [lost for k in nested for lost in lost_keys(old[k], new[k], f"{prefix}{k}.")]


def changed_keys(old: dict, new: dict, prefix: str = "") -> list[str]:
    """Dotted keys whose values differ, but for those that change nothing of what a run has done so far."""
    keys = []
    for key in sorted({*old, *new} - CHANGE_NOTHING, key=str):
        a, b = old.get(key), new.get(key)
        if f"{prefix}{key}" in HOW_IT_IS_REACHED:
            continue
        if prefix == "target.":  # where nothing said is nothing
            a, b = ({} if v is None and isinstance(other, dict) else v for v, other in ((a, b), (b, a)))
        if isinstance(a, dict) and isinstance(b, dict):
            keys += changed_keys(a, b, f"{prefix}{key}.")
        elif a != b:
            keys.append(f"{prefix}{key}")
    return keys


def goes_further(old: dict, new: dict) -> bool:
    """Whether a run is only asked for more grounding steps: what it has done does not depend on how many follow.

    References and baselines do depend on it: they train for as long as all of a run's policies together.
    """
    before, now = (config["schedule"].get("grounding_steps") for config in (old, new))
    alone = new.get("method", "idapt") == "idapt" and not (old.get("oracle") or new.get("oracle"))
    return alone and isinstance(before, int) and isinstance(now, int) and now > before
