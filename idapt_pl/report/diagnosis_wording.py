"""A diagnosis in words: the verdict as sentences."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from idapt_pl.effects.wording import format_estimate, format_number, listing, phrase_at, unit_at

HEADLINES = {
    "effects_found": "Found what the model lacks",
    "no_missing_effect": "Nothing is missing",
    "unexplained_residual": "Something is missing that no known effect explains",
    "insufficient_excitation": "These recordings cannot tell",
}


def effect_sentence(effect: dict, model: mujoco.MjModel) -> str:
    """One effect of the report: what, where, how much, and how surely."""
    parts, several = [], len(effect["parameters"]) > 1
    for name, p in effect["parameters"].items():
        value, interval = format_estimate(p["estimate"], p["ci95"])
        unit = unit_at(model, effect["target"], p["unit"])
        words = f"{name} {value}" if several else value
        words += f" {unit}" if unit not in ("", "1") else ""
        words += f" (95 %: {interval})" if interval else ""
        if p["nominal"] not in (0, 0.0, p["estimate"]):
            shown = p["nominal"] if isinstance(p["nominal"], str) else format_number(p["nominal"])
            words += f" instead of {shown}"
        parts.append(words)
    return f"{phrase_at(effect['effect'], effect['target'])}, {', '.join(parts)}"


def headline(report: dict) -> str:
    """The verdict in a few words."""
    if report["verdict"] == "unexplained_residual" and report["effects"]:
        return "Something is still missing that no known effect explains"
    return HEADLINES[report["verdict"]]


def verdict_in_words(report: dict, model: mujoco.MjModel) -> list[str]:
    """The verdict as sentences, the most important first."""
    makers = {
        "effects_found": found_sentences,
        "no_missing_effect": nothing_missing_sentences,
        "unexplained_residual": unexplained_sentences,
        "insufficient_excitation": quiet_sentences,
    }
    return [*makers[report["verdict"]](report, model), *undecided_sentences(report)]


def found_sentences(report: dict, model: mujoco.MjModel) -> list[str]:
    """What the model lacks, and what adding it gains."""
    return [
        lacking_sentence(report, model),
        gain_sentence(report["error"], "it" if len(report["effects"]) == 1 else "them"),
    ]


def lacking_sentence(report: dict, model: mujoco.MjModel) -> str:
    """What was found, as a sentence."""
    effects = report["effects"]
    listed = "; ".join(effect_sentence(e, model) for e in effects)
    new = all(p["nominal"] == 0 for e in effects for p in e["parameters"].values())
    what = ("effect" if new else "change") + "s" * (len(effects) > 1)
    how_many = "one" if len(effects) == 1 else str(len(effects))
    return f"The model {'lacks' if new else 'needs'} {how_many} {what}: {listed}."


def gain_sentence(error: dict, them: str) -> str:
    """What adding the effects does to the held-out error."""
    share = error["removed_share"]
    removes = f"removes {100 * share:.0f} % of the removable error" if share > 0 else "changes the error"
    return (
        f"Adding {them} {removes} on episodes not used for fitting: from {format_number(error['before'])} "
        f"to {format_number(error['after'])} times the measurement noise."
    )


def nothing_missing_sentences(report: dict, model: mujoco.MjModel) -> list[str]:
    """That the model is as good as the data can show."""
    level = report["error"]["after"]
    sentences = [
        "No missing effect: none of the effects tried makes the predictions of episodes not used for fitting "
        "better than chance would."
    ]
    if level < 1.3:
        return [*sentences, f"The error is {format_number(level)} times the measurement noise; 1 is as good as can be."]
    return [
        *sentences,
        f"The error is {format_number(level)} times the measurement noise, but neither state nor commands predict the rest.",
    ]


def unexplained_sentences(report: dict, model: mujoco.MjModel) -> list[str]:
    """What was found all the same, and that it does not suffice."""
    error = report["error"]
    level = f"{format_number(error['after'])} times the measurement noise"
    if not report["effects"]:
        return [
            f"The model lacks something, and no effect of the library explains it: the error is {level} on episodes "
            "not used for fitting."
        ]
    helps = "; ".join(effect_sentence(e, model) for e in report["effects"])
    return [
        f"Part of the error stays unexplained: {level} on episodes not used for fitting is left after all that helps.",
        f"What helps: {helps}.",
        gain_sentence(error, "it" if len(report["effects"]) == 1 else "them"),
    ]


def quiet_sentences(report: dict, model: mujoco.MjModel) -> list[str]:
    """That the recordings would not have shown an effect."""
    return [
        "These recordings cannot tell whether something is missing: they move the mechanism so little that even a "
        "strong effect would hide in the measurement noise."
    ]


def undecided_sentences(report: dict) -> list[str]:
    """Which effects are one of several that explain the data equally well."""
    sentences = []
    for e in report["effects"]:
        own = phrase_at(e["effect"], e["target"])
        others = [phrase_at(q["effect"], q["target"]) for q in e.get("equivalent", ())]
        if others:
            others = ["another form of it" if o == own else o for o in others]
            sentences.append(f"These data cannot tell {own} from {listing(others)}.")
    return sentences


def error_rows(report: dict) -> list[tuple[str, float, str]]:
    """The table before, after, floor, ceiling: name, value, what it means."""
    error = report["error"]
    given = "the model as it was given" + (", with the effects declared" if report["declared"] else "")
    return [
        ("before", error["before"], given),
        ("after", error["after"], "with the effects below" if report["effects"] else "the same: nothing was added"),
        ("noise floor", error["noise_floor"], "a perfect model: what the measurement noise alone leaves"),
        ("ceiling", error["ceiling"], "the given model, corrected by a black box (a regression on state and commands)"),
    ]


def episode_list(numbers: Sequence[int], most: int = 12) -> str:
    """As in "episodes 0, 1, 2", or how many there are where they are more than anyone reads."""
    if len(numbers) > most:
        return f"{len(numbers)} episodes"
    return f"episode{'s' * (len(numbers) != 1)} {', '.join(map(str, numbers))}"


def worst_channels(per_channel: dict[str, dict], most: int = 4) -> list[str]:
    """The 2 to ``most`` channels with the largest error relative to noise, in the model's order."""
    ratio = np.array([c["before"] / max(c["noise"], 1e-12) for c in per_channel.values()])
    keep = np.argsort(-ratio)[:most]
    names = list(per_channel)
    return [names[i] for i in np.sort(keep[(ratio[keep] > 0.1 * ratio.max()) | (np.arange(len(keep)) < 2)])]
