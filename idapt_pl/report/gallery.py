"""A page of all tasks: the same states in every domain, and what differs, read from the compiled models."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import imageio.v3 as iio
import mujoco
import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.differences import Difference, differences
from idapt_pl.effects.runtime import CommandEffect
from idapt_pl.envs import VectorImageEnv
from idapt_pl.rl.exploration import babbling_policy
from idapt_pl.tasks import Task

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse; font-size: 13px } td, th { padding: 2px 12px 2px 0; text-align: left }
tr { border-bottom: 1px solid #ddd } td { font-variant-numeric: tabular-nums; vertical-align: top }
img { margin: 0 6px 6px 0; vertical-align: top } .name { display: inline-block; width: 5em }
"""


@dataclass(frozen=True)
class LearnedLook:
    """What a run learned of a target's looks.

    Attributes:
        task: name of the task.
        target: name of the domain.
        image_size: side of the images it works on, pixels.
        frames: images it translates together.
        translate: G, uint8 (n, frames, size, size, 3) to the same.
    """

    task: str
    target: str
    image_size: int
    frames: int
    translate: Callable[[np.ndarray], np.ndarray]


def domain_pictures(
    task: Task, size: int, moments: Iterable[int], learned: Sequence[LearnedLook] = (), seed: int = 0
) -> dict[str, list[np.ndarray]]:
    """The same states in every domain, along one exploration of the source, and the source as G shows it.

    Domain, or ``G to <domain>``, to images uint8 (side, side, 3).
    """
    moments = sorted(moments)
    with ExitStack() as stack:
        envs = {name: VectorImageEnv(task, domain, 1, size, 1) for name, domain in task.domains().items()}
        shown_to = {g.target: VectorImageEnv(task, task.domain("source"), 1, g.image_size, 1) for g in learned}
        for env in (*envs.values(), *shown_to.values()):
            stack.callback(env.close)
        shown: dict[str, list[np.ndarray]] = {name: [] for name in (*envs, *(f"G to {g.target}" for g in learned))}
        source = envs["source"]
        obs, _ = source.reset(seed=seed)
        act = babbling_policy(source, seed)
        for t in range(moments[-1] + 1):
            if t in moments:
                for name, env in envs.items():
                    shown[name].append(env.show(0, source.data[0]))
                for g in learned:
                    still = np.repeat(shown_to[g.target].show(0, source.data[0])[None, None], g.frames, axis=1)
                    shown[f"G to {g.target}"].append(g.translate(still)[0, -1])
            obs, *_ = source.step(act(obs["pixels"]))
        return shown


def beyond_mjcf(domain: Domain) -> list[Difference]:
    """The domain's effects that its model cannot show, since MJCF has no words for them."""
    found = []
    for effect in domain.effects:
        if isinstance(effect, CommandEffect) and not effect.in_mjcf:
            entry = effect.to_dict()
            found.append(Difference(entry["effect"], entry["target"], "none", entry["parameters"]))
    return found


def domain_comparison(task: Task) -> list[tuple[str, str, bool, dict[str, Any]]]:
    """Rows of the table: field, element, whether it is only seen, and its value in each domain that differs."""
    domains = task.domains()
    models = {name: domain.compile() for name, domain in domains.items()}
    rows: dict[tuple[str, str], tuple[bool, dict[str, Any]]] = {}
    for name in (n for n in domains if n != "source"):
        for d in differences(models["source"], models[name]) + beyond_mjcf(domains[name]):
            _, values = rows.setdefault((d.field, d.element), (d.visual, {"source": d.before}))
            values[name] = d.after
    return [(field, element, visual, values) for (field, element), (visual, values) in rows.items()]


def group_rows(rows: list[tuple[str, str, bool, dict[str, Any]]]) -> list[tuple[str, str, bool, dict[str, Any]]]:
    """Rows of one field with the same values put together; of what was added or left out, how many there are."""
    groups: dict[tuple, list[str]] = {}
    for field, element, visual, values in rows:
        told = {
            k: None if v is None else "present" if isinstance(v, str) and v == element else format_value(v)
            for k, v in values.items()
        }
        groups.setdefault((field, visual, tuple(told.items())), []).append(element)
    result = []
    for (field, visual, told), elements in groups.items():
        named = ", ".join(elements) if len(elements) <= 6 else f"{len(elements)}: {', '.join(elements[:3])}, ..."
        result.append((field, named, visual, {k: "-" if v is None else v for k, v in told}))
    return result


def format_value(value: Any) -> str:
    """A value for a reader: four digits, arrays in brackets without zeros at their end."""
    if isinstance(value, dict):
        return ", ".join(f"{k} {format_value(v)}" for k, v in value.items())
    if isinstance(value, np.ndarray) and value.ndim:
        rounded = np.where(np.abs(value) < 1e-9, 0.0, value).ravel()
        kept = rounded if value.size <= 4 else np.trim_zeros(rounded, "b")
        return "(" + ", ".join(f"{v:.4g}" for v in kept) + ")" if kept.size else "0"
    return f"{float(value):.4g}" if isinstance(value, int | float | np.number | np.ndarray) else str(value)


def task_section(task: Task, size: int, moments: Iterable[int], learned: Sequence[LearnedLook]) -> str:
    """One task as HTML."""
    model = task.domain("source").compile()
    data = mujoco.MjData(model)
    task.reset(model, data, np.random.default_rng(0))
    mujoco.mj_forward(model, data)
    facts = {
        "control period": f"{task.period(model):g} s",
        "horizon": f"{task.horizon} control steps",
        "actions": f"{model.nu}, from {format_value(model.actuator_ctrlrange.T[0])} to {format_value(model.actuator_ctrlrange.T[1])}",
        "state": f"{len(task.state(model, data))} numbers",
        "metric": task.metric,
    }
    parts = [f"<h2>{task.name}</h2><p>{'; '.join(f'{k}: {v}' for k, v in facts.items())}</p>"]
    for name, images in domain_pictures(task, size, moments, learned).items():
        parts.append(f"<div><span class=name>{name}</span>{''.join(inline_image(i, size) for i in images)}</div>")
    parts.append(difference_table(group_rows(domain_comparison(task)), list(task.domains())))
    return "\n".join(parts)


def difference_table(rows: list[tuple[str, str, bool, dict[str, Any]]], domains: list[str]) -> str:
    """The differences as HTML, physical ones first; a domain that does not differ shows the source's value."""
    lines = [f"<tr><th>{'</th><th>'.join(['', 'field', 'of', *domains])}</th></tr>"]
    for field, element, visual, values in sorted(rows, key=lambda row: row[2]):
        cells = ["seen" if visual else "<b>moves</b>", field, html.escape(element)]
        cells += [html.escape(values.get(name, values["source"])) for name in domains]
        lines.append(f"<tr><td>{'</td><td>'.join(cells)}</td></tr>")
    return f"<table>{''.join(lines)}</table>"


def inline_image(image: np.ndarray, width: int) -> str:
    """An image as HTML that needs no file beside it."""
    data = base64.b64encode(iio.imwrite("<bytes>", image, extension=".png")).decode()
    return f'<img src="data:image/png;base64,{data}" width="{width}" alt="">'


def gallery_page(
    tasks: Iterable[Task], size: int = 200, moments: Iterable[int] = (0, 8, 16, 32), learned: Iterable[LearnedLook] = ()
) -> str:
    """The whole page."""
    learned = tuple(learned)
    moments = tuple(moments)
    intro = (
        "Every row of pictures shows the same states, reached by an exploration of the source. The tables list every "
        "field in which a compiled model differs from the source's, and effects that MJCF has no words for."
        + " Rows called G show the source as a trained visual transformation translates it."
        * bool(learned)
    )
    body = "\n".join(task_section(task, size, moments, [g for g in learned if g.task == task.name]) for task in tasks)
    head = f"<!doctype html><meta charset=utf-8><title>Tasks and domains</title><style>{STYLE}</style>"
    return f"{head}<h1>Tasks and domains</h1><p>{intro}</p>{body}\n"
