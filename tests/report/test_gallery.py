"""The gallery shows every domain in the same states, and says what the models say."""

import re

import numpy as np

from cli.main import main
from idapt_pl.report.domain_comparison import compare_domains, group_differences
from idapt_pl.report.gallery import LearnedTranslation, domain_pictures
from idapt_pl.tasks import make_task


def test_pictures_show_the_same_states_in_every_domain():
    shown = domain_pictures(make_task("inverted_pendulum"), 16, (0, 5))
    assert set(shown) == {"source", "easy", "hard"}
    assert all(len(images) == 2 and images[0].shape == (16, 16, 3) for images in shown.values())
    assert (shown["source"][0] != shown["hard"][0]).any()


def test_what_a_run_learned_is_shown_beside_its_domain():
    """A G that turns colours round gets the source, at its own size, in the states of the other rows."""
    negative = LearnedTranslation("inverted_pendulum", "hard", 24, 3, lambda pixels: 255 - pixels)
    shown = domain_pictures(make_task("inverted_pendulum"), 24, (0, 5), [negative])
    assert list(shown) == ["source", "easy", "hard", "G to hard"]
    assert all((255 - g == s).all() for g, s in zip(shown["G to hard"], shown["source"], strict=True))


def test_comparison_reads_table_1_from_the_models():
    rows = {(d.field, d.element): d.values for d in compare_domains(make_task("walker2d"))}
    assert {k: np.round(v, 6) for k, v in rows["body_mass", "torso"].items()} == {
        "source": 3.534,
        "easy": 5.4,
        "hard": 10,
    }


def test_what_mjcf_has_no_words_for_is_in_the_table_too():
    rows = group_differences(compare_domains(make_task("fetch_reach")))
    turned = next(d for d in rows if d.field == "actuator_rotation")
    assert (turned.element, turned.visual) == ("x y", False) and "0.7854" in turned.values["hard"]


def test_command_writes_one_page_that_needs_no_other_file(tmp_path, capsys):
    assert main(["gallery", "--task", "half_cheetah", "--image-size", "16", "--out", str(tmp_path / "g")]) == 0
    page = (tmp_path / "g/index.html").read_text()
    assert page.count("<img") == 12 and not re.search(r'src="(?!data:)', page)
    assert "bthigh, bshin, bfoot, fthigh, fshin, ffoot</td><td>0.1</td><td>0.18</td><td>0.4" in page
