"""A run folder remembers its config, in two places that must agree."""

import pytest
import yaml

from idapt_pl.files import DamagedFile, write_json, write_yaml
from idapt_pl.run_folder.kept_config import changed_keys, read_kept_config

CONFIG = {"seed": 3, "run_dir": "runs/a", "visual": {"width": 4, "blocks": 1}, "trainer": {"devices": 1}}


@pytest.fixture
def run(tmp_path):
    write_yaml(tmp_path / "config.yaml", CONFIG)
    write_json(tmp_path / "run.json", {"seed": 3, "config": CONFIG}, checked=True)
    return tmp_path


def test_a_lost_config_comes_back(run):
    (run / "config.yaml").unlink()
    assert read_kept_config(run) == CONFIG == yaml.safe_load((run / "config.yaml").read_text())


def test_of_an_older_run_config_yaml_is_enough(run):
    (run / "run.json").unlink()
    assert read_kept_config(run) == CONFIG


def test_a_folder_without_either_holds_no_run(tmp_path):
    assert read_kept_config(tmp_path) is None


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"seed": 4}, "seed"),
        ({"visual": {"width": 5, "blocks": 1}}, "visual.width"),
        ({"visual": {"width": 4}}, "visual.blocks"),
        ({"trainer": {"devicez": 1}}, "trainer.devices"),
    ],
)
def test_a_config_that_is_not_that_of_the_run_is_refused_by_key(run, change, key):
    write_yaml(run / "config.yaml", CONFIG | change)
    with pytest.raises(DamagedFile, match=rf"config\.yaml: is not the config .*{key} differ.*Delete it"):
        read_kept_config(run)


def test_where_the_folder_is_and_on_what_it_trains_may_differ_and_a_newer_version_may_know_more(run):
    newer = CONFIG | {"run_dir": "elsewhere", "trainer": {"devices": 2}, "new": 1}
    write_yaml(run / "config.yaml", newer)
    assert read_kept_config(run) == newer


def test_how_a_target_is_reached_may_differ_and_what_it_is_may_not():
    robot = {"env": "lab:make", "horizon": 9, "options": {"port": 1}, "measure": False}
    reached = robot | {"patience": 60, "attended": True, "measure": "ask", "options": {"port": 2, "host": "arm"}}
    assert changed_keys({"target": robot}, {"target": reached}) == []
    assert changed_keys({"target": robot | {"options": None}}, {"target": robot}) == []
    assert changed_keys({"target": robot}, {"target": robot | {"options": {"mass": 1}}}) == ["target.options.mass"]
    assert changed_keys({"target": robot}, {"target": robot | {"horizon": 8}}) == ["target.horizon"]
    assert changed_keys({"target": robot}, {"target": "hard"}) == ["target"]
    assert changed_keys({"patience": 1}, {"patience": 2}) == ["patience"]


@pytest.mark.parametrize("content", ["", "seed: [", "- 1", "a: 1\na: 2"])
def test_a_damaged_config_is_named_with_its_cure(run, content):
    (run / "config.yaml").write_text(content)
    with pytest.raises(DamagedFile, match=r"config\.yaml: .*comes back from run\.json"):
        read_kept_config(run)
    (run / "run.json").unlink()
    with pytest.raises(DamagedFile, match=r"config\.yaml: .*Put back"):
        read_kept_config(run)


def test_a_damaged_run_json_is_named_with_its_cure(run):
    (run / "run.json").write_text((run / "run.json").read_text().replace('"seed": 3', '"seed": 4'))
    with pytest.raises(DamagedFile, match=r"run\.json: .*Delete it"):
        read_kept_config(run)


def test_changed_keys_are_dotted():
    assert changed_keys({"a": {"b": 1, "c": 2}, "d": 3}, {"a": {"b": 1, "c": 4}}) == ["a.c", "d"]
