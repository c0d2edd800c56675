"""The page about a run: the whole story from the folder alone, also where pieces of it are missing."""

import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import yaml
from conftest import TINY, numbered_episodes

from cli.main import main
from datamodules import write_trajectories
from idapt_pl.diagnosis.answer.result import ChannelError, EffectEstimate, ParameterEstimate
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.joints import JointArmature
from idapt_pl.files import read_json, write_json, write_yaml
from idapt_pl.image_diagnosis.result import (
    EnsembleBand,
    ForecastChannel,
    ForecastEvidence,
    ForecastExample,
    ImageDiagnosis,
    WindowEvidence,
)
from idapt_pl.report.run_pictures import spread_stacks, translated_examples
from idapt_pl.report.run_record import read_run_record
from idapt_pl.run_folder.kept_warnings import WARNINGS
from idapt_pl.worlds import Worlds

STEPS = TINY["schedule.grounding_steps"]


class Page(HTMLParser):
    """Visible text, pictures, and everything that a browser would fetch."""

    def __init__(self, text):
        super().__init__()
        self.words, self.pictures, self.fetched, self._style = [], [], [], False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self._style = tag == "style"
        for name, value in attrs:
            if name in ("src", "href", "xlink:href") and not value.startswith("#"):
                (self.pictures if value.startswith("data:") else self.fetched).append(value)
        if tag in ("script", "link", "iframe"):
            self.fetched.append(tag)

    def handle_data(self, data):
        if not self._style:
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


def report(run):
    """``idapt report`` of a run folder."""
    assert main(["report", "--run", str(run)]) == 0
    return Page((run / "report.html").read_text())


@pytest.fixture
def copied(finished_run, tmp_path):
    shutil.copytree(finished_run, tmp_path / "run")
    (tmp_path / "run/report.html").unlink()
    return tmp_path / "run"


def test_fit_leaves_a_page_that_needs_nothing_beside_it(finished_run):
    text = (finished_run / "report.html").read_text()
    page = Page(text)
    assert page.fetched == [] and "@import" not in text and "url(http" not in text
    kinds = [p.split(";")[0] for p in page.pictures]
    assert kinds.count("data:image/png") == 12 * (STEPS + 1) and kinds.count("data:image/gif") == STEPS + 1


def test_the_page_tells_what_was_measured_and_that_it_was_not_selected_on(finished_run):
    text = Page((finished_run / "report.html").read_text()).text
    summary = json.loads((finished_run / "summary.json").read_text())
    for value in (summary["direct_transfer"], summary["visual_only"], *summary["grounded"]):
        assert f"{value:.1f} ±" in text
    assert "evaluation only: nothing in the run was trained or selected on it" in text
    assert f"Target interactions: {summary['target_interactions']}" in text.replace(",", "")
    for k in range(STEPS + 1):
        assert f"Step {k}:" in text
    assert "inverted_pendulum, source to hard, seed 3" in text and "not trained oracle" in text


def test_the_page_is_made_from_the_folder_without_a_target_and_is_the_same_each_time(copied, finished_run, monkeypatch):
    def forbidden(*args):
        raise AssertionError("the report makes no target")

    monkeypatch.setattr(Worlds, "rewarded_target", forbidden)
    report(copied)
    assert (copied / "report.html").read_text() == (finished_run / "report.html").read_text()


def test_returns_stand_at_the_interactions_that_their_policy_had_cost(finished_run):
    used = [s.interactions for s in read_run_record(finished_run).steps]
    images, more = TINY["schedule.images"], TINY["schedule.interactions"]
    assert used == [images + k * more for k in range(STEPS + 1)]


def test_a_killed_run_has_a_page_too_which_says_how_to_go_on(copied):
    last = copied / f"step_{STEPS:02d}"
    for name in ("evaluation.json", "policy_in_grounded_and_target.gif"):
        (last / name).unlink()
    shutil.rmtree(last / "policy")
    for name in ("summary.json", "run.json"):
        (copied / name).unlink()
    text = report(copied).text
    assert f"{STEPS} of {STEPS + 1} steps are done" in text and f"idapt fit --config {copied}" in text
    assert "This step did not end: there is no evaluation. Finished in it: target, source" in text
    assert "run.json is missing" in text


def test_a_run_that_has_hardly_begun_has_a_page(copied):
    for folder in copied.glob("step_*"):
        shutil.rmtree(folder)
    (copied / "ledger.json").unlink()
    text = report(copied).text
    assert "No step has been evaluated yet" in text and "None has been made yet" in text


def test_how_actions_are_told_to_a_target_of_ones_own_is_told(copied):
    target = {"target": {"env": "lab:make", "actions": {"scale": [0.5], "offset": 0.1}}}
    started = read_json(copied / "run.json")
    write_json(copied / "run.json", started | {"config": started["config"] | target}, checked=True)
    write_yaml(copied / "config.yaml", yaml.safe_load((copied / "config.yaml").read_text()) | target)
    assert "the target's actions are the source's with scale [0.5], offset 0.1" in report(copied).text


def test_a_shortened_run_says_first_of_all_what_it_is_worth(copied):
    assert "divided" not in report(copied).text
    write_json(copied / "run.json", read_json(copied / "run.json") | {"shortened_by": 200.0}, checked=True)
    text = report(copied).text
    said = text.index("Lengths divided by 200: this shows that it runs, not what it can reach.")
    assert said < text.index("in the target:")


def test_what_the_run_warned_of_is_told(copied):
    (copied / WARNINGS).unlink(missing_ok=True)
    assert "warned of" not in report(copied).text
    write_json(copied / WARNINGS, {"warnings": ["begin anew, by x < 12", "of another thing"]})
    text = report(copied).text
    assert "What the run warned of" in text and "begin anew, by x < 12" in text and "of another thing" in text


def test_damaged_files_are_named_and_the_rest_is_told(copied):
    (copied / "step_01/evaluation.json").write_text('{"target": ')
    (copied / "step_00/target.h5").write_bytes(b"not an HDF5 file")
    (copied / "step_02/visual/final.ckpt").write_bytes(b"short")
    (copied / "step_02/effects.json").write_text('{"effects": []}')
    text = report(copied).text
    assert "cannot be read and are left out: step_01/evaluation.json, step_02/effects.json." in text
    assert len(re.findall("No pictures: ", text)) == 2 and "target.h5: cannot be used (its content does" in text


def estimate(effect, target, name, nominal, value, ci95, unit):
    """An effect with one parameter."""
    parameters = {name: ParameterEstimate(nominal, value, ci95, unit)}
    return EffectEstimate(effect, target, parameters, {}, 1.0, 2.0, ())


MASS = estimate("body_mass", "pole", "mass", 4.9, 187.3, (180.1, 194.2), "kg")
HINGE = ChannelError(before=0.456, after=0.0135, noise=0.0123, unit="rad")
BY_WINDOWS = ImageDiagnosis(
    effects=(BodyMass("pole", 187.3),),
    rejected=(JointArmature("hinge", 3.0),),
    estimates=(MASS, estimate("joint_armature", "hinge", "armature", 0.0, 3.0, (2.0, 4.0), "kg·m² or kg")),
    excess=25.0,
    explained=0.9,
    removed={"target": 0.94, "control": 0.0},
    excluded_frames={"target": 0.0125, "control": 0.0},
    sensor_errors={"position": [None, 0.0123]},
    before=17.5,
    after=1.04,
    target={"hinge position": HINGE},
    control={"hinge position": replace(HINGE, before=0.0182)},
    evidence=WindowEvidence(
        found_in_control=(),
        negligible=(estimate("actuator_delay", "slide", "delay", 0.0, 0.02, (0.01, 0.03), "s"),),
        unknown_gain=0.05,
    ),
)
BAND = EnsembleBand(mean=(0.1, 0.2), low=(0.0, 0.1), high=(0.2, 0.3))
EXAMPLE = ForecastExample(0.04, {"hinge": ForecastChannel("rad", (0.1, 0.3), BAND, replace(BAND, mean=(0.1, 0.3)))})
BY_FORECASTS = replace(BY_WINDOWS, removed={"target": 0.94}, evidence=ForecastEvidence(0.1, EXAMPLE))


@pytest.mark.parametrize("diagnosis", [BY_WINDOWS, BY_FORECASTS])
def test_effects_json_holds_all_of_a_diagnosis(diagnosis):
    entry = json.loads(json.dumps(diagnosis.to_dict()))
    assert ImageDiagnosis.from_dict({"step": 1, "wall_s": 2.0} | entry) == diagnosis
    assert ("forecasts" in entry, "example" in entry, "unknown_gain" in entry) == (
        diagnosis.by_forecasts, diagnosis.by_forecasts, not diagnosis.by_forecasts,
    )  # fmt: skip


def test_effects_json_of_earlier_versions_is_read_too():
    entry = {k: v for k, v in BY_WINDOWS.to_dict().items() if k not in ("left_out", "unread", "unknown_gain")}
    assert ImageDiagnosis.from_dict(entry).negligible == ()


def test_rollback_effects_and_the_oracle_are_told(copied):
    low, high = 0.5, 0.7
    decision = {"before": 0.1, "after": 0.7, "worse_by": 0.6, "ci95": [low, high], "rolled_back": True,
                "held_out_steps": 194}  # fmt: skip
    (copied / "step_01/selection.json").write_text(json.dumps(decision))
    (copied / "step_02/effects.json").write_text(json.dumps(BY_WINDOWS.to_dict()))
    (copied / "step_00/oracle_evaluation.json").write_text(json.dumps({"mean": 987.0, "std": 1.0}))
    text = report(copied).text
    assert "F is rolled back: it is clearly worse" in text and "+0.5 to +0.7" in text
    assert "mass of body pole mass 187 180 to 194 kg added to the source" in text
    assert "not believed: it may be an error of the estimator" in text
    assert "0.010 to 0.030 s not believed: too little goes with it" in text
    assert "17.5 times the sensor's noise away" in text and "1.04 times with all the effects found" in text
    assert "hinge position rad 0.0123 0.456 0.0135 0.0182" in text
    assert "left out: 1.25 % of the target's, 0 % of the control's" in text.replace("&#x27;", "'")
    assert "readings that are 5 % too large or small" in text
    assert "987 ± 1.0 oracle" in text
    (copied / "step_02/effects.json").write_text(json.dumps(BY_FORECASTS.to_dict()))
    text = report(copied).text
    assert "energy score of what is read of the target is 17.5, and 1.04 with the effects added" in text
    assert "(less is better; 0.7 where the source forecasts itself)" in text
    assert "not believed: forecasts are not surely better" in text and "the source forecasts these" in text
    assert "10 % by which G and the sensor may mislead an estimate" in text


def test_a_search_from_known_starts_is_told_whatever_it_found(copied):
    effect = {"effect": "body_mass", "target": "pole", "parameters": {"mass": 195.0}}
    how = {"effect": "body_mass", "target": "pole", "parameter": "mass", "before": 150.0, "after": 195.0}
    searched = {"effects": [], "best": [effect], "parameters": [how | {"log_halfwidth": 0.2}],
                "error": {"before": 0.35, "after": 0.33}, "gain": {"mean": 0.02, "standard_error": 0.015},
                "tried": [{"candidate": "body_mass(pole)", "value": 150.0, "error": 0.34}]}  # fmt: skip
    path = copied / "step_02/known_start_search.json"
    (copied / "step_02/effects.json").write_text(json.dumps(BY_WINDOWS.to_dict()))
    path.write_text(json.dumps(searched))
    text = report(copied).text
    assert "best with what the table has: their error falls from 0.35 to 0.33 (by 0.02 nats, ± 0.015, one" in text
    assert "mass of body pole mass 195 20 %" in text
    assert "That is not enough, and nothing was added." in text and "body_mass(pole) 150 0.34" in text
    path.write_text(json.dumps(searched | {"gain": {"mean": 0.02, "standard_error": None}}))
    assert "(by 0.02 nats, in fewer than half of the recordings)" in report(copied).text
    path.write_text(json.dumps(searched | {"effects": [effect]}))
    assert "So this was added." in report(copied).text
    path.write_text(json.dumps(searched | {"best": [], "parameters": [], "tried": []}))
    assert "None makes them better." in report(copied).text


def test_a_search_from_known_starts_alone_is_told_too(copied):
    effect = {"effect": "body_mass", "target": "pole", "parameters": {"mass": 195.0}}
    how = {"effect": "body_mass", "target": "pole", "parameter": "mass", "after": 195.0, "log_halfwidth": 0.2}
    searched = {"effects": [effect], "best": [effect], "parameters": [how], "tried": [],
                "error": {"before": 0.35, "after": 0.2}, "gain": {"mean": 0.5, "standard_error": 0.02}}  # fmt: skip
    (copied / "step_00/effects.json").unlink(missing_ok=True)
    assert "Step 0: G alone" in report(copied).text
    (copied / "step_00/known_start_search.json").write_text(json.dumps(searched))
    text = report(copied).text
    assert "Step 0: G, and effects" in text and "mass of body pole mass 195 20 %" in text
    assert "visual grounding, source repaired" in text.lower()


def test_a_folder_that_is_no_run_is_a_plain_error(tmp_path, capsys):
    assert main(["report", "--run", str(tmp_path)]) == 1
    printed = capsys.readouterr()
    assert "is not a run folder: it has no config.yaml" in printed.err and "Traceback" not in printed.err


# --- pictures -------------------------------------------------------------------------------------------


def test_stacks_are_spread_over_the_file_and_stay_within_episodes(tmp_path):
    write_trajectories(tmp_path / "d.h5", numbered_episodes([4] * 20))
    seen = spread_stacks(tmp_path / "d.h5", 10, 3)
    assert seen.shape == (10, 3, 8, 8, 3)
    episode, time = seen[:, :, 0, 0, 0].astype(int), seen[:, :, 0, 0, 1].astype(int)
    assert (episode == episode[:, :1]).all() and (np.diff(episode[:, 0]) > 0).all()
    assert (time == np.maximum(time[:, -1:] + [-2, -1, 0], 0)).all()


def test_the_real_frame_beside_a_translation_is_the_one_most_like_it(tmp_path):
    write_trajectories(tmp_path / "d.h5", numbered_episodes([4] * 20))

    class Identity:
        frames = 1

        def translate(self, pixels):
            return pixels

    seen = translated_examples(tmp_path / "d.h5", tmp_path / "d.h5", Identity())
    assert np.array_equal(seen.source, seen.translated)
    assert np.abs(seen.target.astype(int) - seen.translated).max() <= 1, "of 100 frames all but a few are looked at"
