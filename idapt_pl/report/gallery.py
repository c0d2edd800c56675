"""A page of all tasks: the same states in every domain, and what differs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.envs import VectorImageEnv
from idapt_pl.report.domain_comparison import DomainDifference, compare_domains, format_value, group_differences
from idapt_pl.report.html import (
    TONE,
    document,
    header,
    paragraph,
    picture_grid,
    png_uri,
    row,
    scrollable,
    section,
    table,
)
from idapt_pl.rl.exploration import babbling_policy
from idapt_pl.tasks import Task

GALLERY_CSS = "main { max-width: 72rem; } .grid { margin: .6rem 0; }\n"
"""Four pictures and their name fit beside each other."""


@dataclass(frozen=True)
class LearnedTranslation:
    """G of a run, to be shown beside the domain that it translates to.

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


def gallery_page(
    tasks: Iterable[Task],
    size: int = 200,
    moments: Sequence[int] = (0, 8, 16, 32),
    learned: Sequence[LearnedTranslation] = (),
) -> str:
    """The whole page.

    Args:
        tasks: to be shown.
        size: side of the pictures, pixels.
        moments: control steps of an exploration at which pictures are taken.
        learned: G of finished runs.
    """
    intro = (
        "Every row of pictures shows the same states, reached by an exploration of the source. The tables list every "
        "field in which a compiled model differs from the source's, and effects that MJCF has no words for."
        + " Rows called G show the source as a trained visual transformation translates it."
        * bool(learned)
    )
    title = "Tasks and domains"
    parts = [task_section(task, size, moments, [g for g in learned if g.task == task.name]) for task in tasks]
    return document(title, [header(title, paragraph(intro)), *parts], TONE, GALLERY_CSS)


def task_section(task: Task, size: int, moments: Sequence[int], learned: Sequence[LearnedTranslation]) -> str:
    """One task: facts, pictures, differences."""
    pictures = domain_pictures(task, size, moments, learned)
    grid = picture_grid({name: [png_uri(i) for i in images] for name, images in pictures.items()}, size)
    differences = difference_table(group_differences(compare_domains(task)), list(task.domains()))
    return section(task.name, paragraph(task_facts(task)), scrollable(grid), differences)


def task_facts(task: Task) -> str:
    """What a task's observations, actions and episodes are."""
    model = task.domain("source").compile()
    data = mujoco.MjData(model)
    task.reset(model, data, np.random.default_rng(0))
    mujoco.mj_forward(model, data)
    low, high = map(format_value, model.actuator_ctrlrange.T)
    facts = {
        "control period": f"{task.period(model):g} s",
        "horizon": f"{task.horizon} control steps",
        "actions": f"{model.nu}, from {low} to {high}",
        "state": f"{len(task.state(model, data))} numbers",
        "metric": task.metric,
    }
    return "; ".join(f"{name}: {value}" for name, value in facts.items())


def domain_pictures(
    task: Task, size: int, moments: Iterable[int], learned: Sequence[LearnedTranslation] = (), seed: int = 0
) -> dict[str, list[np.ndarray]]:
    """The same states in every domain, along one exploration of the source, and the source as G shows it.

    Domain, or ``G to <domain>``, to images uint8 (side, side, 3).
    """
    moments = sorted(moments)
    with ExitStack() as stack:
        envs = {name: VectorImageEnv(task, domain, 1, size, 1) for name, domain in task.domains().items()}
        translated = {g.target: VectorImageEnv(task, task.domain("source"), 1, g.image_size, 1) for g in learned}
        for env in (*envs.values(), *translated.values()):
            stack.callback(env.close)
        pictures: dict[str, list[np.ndarray]] = {name: [] for name in (*envs, *(f"G to {g.target}" for g in learned))}
        source = envs["source"]
        obs, _ = source.reset(seed=seed)
        act = babbling_policy(source, seed)
        for t in range(moments[-1] + 1):
            if t in moments:
                for name, env in envs.items():
                    pictures[name].append(env.show(0, source.data[0]))
                for g in learned:
                    still = np.repeat(translated[g.target].show(0, source.data[0])[None, None], g.frames, axis=1)
                    pictures[f"G to {g.target}"].append(g.translate(still)[0, -1])
            obs, *_ = source.step(act(obs["pixels"]))
        return pictures


def difference_table(rows: Iterable[DomainDifference], domains: Sequence[str]) -> str:
    """The differences, physical ones first; a domain that does not differ shows the source's value."""
    lines = []
    for d in sorted(rows, key=lambda d: d.visual):
        values = (d.values.get(name, d.values["source"]) for name in domains)
        lines.append(row("seen" if d.visual else "moves", d.field, d.element, *values))
    return table(("", "field", "of", *domains), lines)
