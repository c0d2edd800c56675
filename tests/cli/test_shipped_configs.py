"""Configs of the package can be given in any folder, as from a clone; files that are there come first."""

import pytest
from conftest import ROOT

from cli.main import main
from idapt_pl.run_folder.shipped_configs import config_path, with_shipped_configs

NAME = "configs/pendulum_quick.yaml"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_config_of_the_package_is_found_from_an_empty_folder(capsys):
    assert config_path(NAME) == ROOT / NAME
    with pytest.raises(SystemExit, match="0"):
        main(["fit", "--config", NAME, "--print_config"])
    assert "task: inverted_pendulum" in capsys.readouterr().out


def test_a_file_that_is_there_comes_first(tmp_path):
    (tmp_path / "configs").mkdir()
    (tmp_path / NAME).write_text("seed: 7")
    assert with_shipped_configs(["--config", NAME, "--seed", "1"]) == ["--config", NAME, "--seed", "1"]


def test_names_and_values_that_are_no_shipped_configs_stay_as_they_are():
    there = str(ROOT / NAME)
    assert with_shipped_configs(["--config", NAME, f"-c={NAME}"]) == ["--config", there, f"-c={there}"]
    for told in (["--config", "my.yaml"], ["--config", "configs/none.yaml"], ["--out", NAME], ["--config", "{a: 1}"]):
        assert with_shipped_configs(told) == told
    assert with_shipped_configs(["--config", "../configs/pendulum_quick.yaml"])[1].startswith(".."), "no way out"


def test_one_that_is_nowhere_is_an_error_that_names_it(capsys):
    assert main(["fit", "--config", "configs/none.yaml"]) == 2
    assert "configs/none.yaml" in capsys.readouterr().err
