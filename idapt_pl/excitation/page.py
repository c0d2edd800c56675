"""The page of a motion, for a person."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import mujoco
from matplotlib.figure import Figure

from idapt_pl.effects.wording import format_number, unit_at
from idapt_pl.excitation.design import SEPARATED, Goal, MotionDesign
from idapt_pl.excitation.forecast import MotionForecaster
from idapt_pl.excitation.rivals import Rival
from idapt_pl.excitation.wording import motion_headline, motion_in_words, standing_in_words
from idapt_pl.report.html import data_uri, document, figure, header, image, paragraph, row, scrollable, section, table
from idapt_pl.report.plots import svg

APART, TOGETHER = "#1d6fa5", "#b4452c"
"""Colours of the headline."""


def motion_page(
    design: MotionDesign, rivals: Sequence[Rival], forecaster: MotionForecaster, goal: Goal, parameters: Sequence[dict],
    drawn: Figure, clip: bytes | None, names: tuple[str, str, str],
) -> str:  # fmt: skip
    """The whole page.

    Args:
        design: the motion.
        rivals: the explanations.
        forecaster: that simulated them.
        goal: of the motion.
        parameters: rows of the table of parameters, as in ``next.json``.
        drawn: the picture.
        clip: a GIF, if there is one.
        names: of the model, the report and the file with the commands.
    """
    first, *more = motion_in_words(design, rivals, goal)
    told = goal is not Goal.SEPARATE or bool((design.separations >= SEPARATED).any())
    lead = [paragraph(first, "lead"), *map(paragraph, more)]
    caption = (
        "Dashed grey: limits. The explanations' lines often lie on each other: what tells them apart is small beside "
        "the motion, but large beside the noise."
    )
    clips = (
        [figure(image(data_uri(clip, "gif"), "the motion"), "As the first explanation predicts it.")] if clip else []
    )
    parts = [
        header(motion_headline(design, goal), *lead, note=f"{names[0]}, after {names[1]}"),
        explanations_section(rivals, forecaster.model),
        pairs_section(design, rivals) if goal is Goal.SEPARATE else "",
        section("The motion", figure(scrollable(svg(drawn)), caption), *clips),
        parameters_section(parameters),
        safety_section(design),
        playing_section(names[2], forecaster),
    ]
    return document("the next recording", parts, APART if told else TOGETHER)


def explanations_section(rivals: Sequence[Rival], model: mujoco.MjModel) -> str:
    """The explanations with their values."""
    rows = []
    for rival in rivals:
        values = [
            f"{name} {format_number(v)} {unit_at(model, c.target, unit)}".removesuffix(" 1")
            for c, x in zip(rival.candidates, rival.x, strict=True)
            for name, v, unit in zip(c.names, x, c.units(), strict=True)
        ]
        rows.append(row(rival.name, standing_in_words(rival), ", ".join(values)))
    return section("Explanations", table(("explanation", "where it stands", "fitted values"), rows))


def pairs_section(design: MotionDesign, rivals: Sequence[Rival]) -> str:
    """Separations of all pairs."""
    found = zip(combinations(rivals, 2), design.separations, design.reachable, strict=True)
    rows = [row(a.name, b.name, f"#{format_number(d)}", f"#{format_number(best)}") for (a, b), d, best in found]
    note = (
        "Standard deviations of the measurement noise between the two predictions of one play, after each explanation "
        f"was fitted again to what the other predicts. From {format_number(SEPARATED)} on they count as told apart. "
        "The last column is the most that any safe motion tried would give; it is linear, and often too large."
    )
    heads = ("explanation", "or", "#apart by this motion", "#by any tried")
    return section("What it tells apart", table(heads, rows), paragraph(note, "small"))


def parameters_section(parameters: Sequence[dict]) -> str:
    """How much the motion narrows what was found."""
    rows = []
    for p in parameters:
        widths = [
            "#-" if p[k] is None else f"#{format_number(p[k])}" for k in ("half_width_now", "half_width_from_motion")
        ]
        rows.append(row(p["name"], f"#{format_number(p['value'])}", *widths, p["unit"]))
    note = (
        "Half widths of 95 % intervals: of the report, and what one play of this motion alone would give; "
        "- where it tells nothing."
    )
    heads = ("parameter", "#estimate", "#now", "#from this motion", "unit")
    return section("Estimates", table(heads, rows), paragraph(note, "small")) if rows else ""


def safety_section(design: MotionDesign) -> str:
    """The tightest places."""
    rows = [
        row(m.what, f"#{format_number(m.reached)}", f"#{format_number(m.limit)}", f"#{100 * m.room:.0f} %")
        for m in sorted(design.margins, key=lambda m: m.room)
    ]
    note = (
        "The tightest place of the whole motion under every explanation, each also with other friction (30 %), masses "
        "and strengths (10 %). This is a simulation: watch the first play, at the emergency stop."
    )
    return section("Safety", table(("limit", "#reached", "#allowed", "#room"), rows), paragraph(note, "small"))


def playing_section(commands: str, forecaster: MotionForecaster) -> str:
    """How to play it and what to do with the recording."""
    start = ", ".join(format_number(v) for v in forecaster.rest)
    steps = (
        f"1. Bring the machine to rest at the start pose ({start}). Hold each row of {commands} until the next.",
        "2. Play it at least twice and record each play as an episode: one to fit, one to judge on.",
        "3. Add these episodes to the recordings so far (idapt import takes several files) and diagnose again. Let "
        "--hold-out name one of the new episodes among those to judge on.",
    )
    return section("What to do with it", *map(paragraph, steps))
