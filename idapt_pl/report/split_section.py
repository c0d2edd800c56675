"""How often each effect is chosen as other episodes are held out."""

from __future__ import annotations

from idapt_pl.diagnosis.answer.split_report import SplitReport, TimesChosen
from idapt_pl.effects.wording import format_number, phrase_at
from idapt_pl.report.explanation_section import all_of
from idapt_pl.report.html import paragraph, row, section, table


def split_section(splits: SplitReport | None) -> str:
    """A table of effects, and in how many searches each was chosen; nothing where that was not asked for."""
    if splits is None:
        return ""
    n = len(splits.searches)
    rows = [
        row(phrase_at(*t.key), f"#{t.times} of {n}", values_in_words(t), "yes" if was_found(splits, t) else "")
        for t in splits.times_chosen()
    ]
    return section(
        "Does it hang on the episodes held out?",
        table(("effect", "#chosen", "values", "in the first search, which is the diagnosis"), rows),
        *map(paragraph, split_sentences(splits)),
    )


def split_sentences(splits: SplitReport | None) -> list[str]:
    """The same in words: how often, what else, and what was found though half of the searches or more lack it."""
    if splits is None:
        return []
    n = len(splits.searches)
    if not splits.times_chosen():
        return [f"Searched {n} times, other episodes held out each time: no effect was chosen."]
    found = [f"{phrase_at(*t.key)} in {t.times}" for t in splits.times_chosen() if was_found(splits, t)]
    besides = [f"{phrase_at(*t.key)} in {t.times}" for t in splits.times_chosen() if not was_found(splits, t)]
    told = all_of(found) if found else "nothing that was found"
    sentences = [f"Searched {n} times, other episodes held out each time, and chosen: {told}."]
    if besides:
        sentences.append(f"Chosen besides: {all_of(besides)}.")
    if doubtful := splits.unsteady():
        what = all_of([phrase_at(*t.key) for t in doubtful])
        sentences.append(f"It hangs on the episodes held out whether this is found: {what}. Record more, or doubt it.")
    return sentences


def was_found(splits: SplitReport, chosen: TimesChosen) -> bool:
    """Whether the diagnosis itself chose an effect."""
    return chosen.key in splits.searches[0].effects


def values_in_words(chosen: TimesChosen) -> str:
    """Ranges of the parameters over the searches."""
    ends = {name: [*dict.fromkeys(map(format_number, both))] for name, both in chosen.ranges.items()}
    return ", ".join(f"{name} {' to '.join(both)}" for name, both in ends.items())
