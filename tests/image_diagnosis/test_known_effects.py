"""What recordings of joints told of a robot goes into the source of a run: `effects.known`."""

import re
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from cli.fit import GroundingCLI, keep_known_effects
from cli.main import main
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.joints import JointStribeck
from idapt_pl.image_diagnosis import known_effects
from idapt_pl.report.run_page import known_section
from idapt_pl.tasks import make_task

TOLD = [
    {"effect": "body_mass", "target": "pole", "parameters": {"mass": 9.0}},
    {"effect": "joint_stribeck", "target": "hinge", "parameters": {"coulomb": 0.1, "static": 0.4, "speed": 0.2}},
    {"effect": "sensor_gain", "target": "slider", "parameters": {"gain": 1.1}},
]
ADDED = (BodyMass("pole", 9.0), JointStribeck("hinge", 0.1, 0.4, 0.2))


def written(folder, entries):
    path = folder / "effects.yaml"
    path.write_text(yaml.safe_dump(entries))
    return path


def test_a_run_begins_with_what_a_diagnosis_wrote(tmp_path, tiny_args):
    cli = GroundingCLI(tiny_args(tmp_path / "run", effects__known=written(tmp_path, TOLD)), shows_bars=False)
    run = cli.run()
    assert run.worlds.added_effects == ADDED  # that of a sensor is none that images show
    assert cli.config.effects.known == TOLD  # the run folder needs no other file
    run.folder.mkdir()
    keep_known_effects(run)
    assert [e["effect"] for e in yaml.safe_load((run.folder / "effects.yaml").read_text())] == [
        "body_mass",
        "joint_stribeck",
    ]
    model = run.worlds.source_domain.compile()
    assert model.body("pole").mass[0] == pytest.approx(9.0) and model.joint("hinge").frictionloss[0] == 0.4
    assert run.worlds.target_domain.compile().body("pole").mass[0] == pytest.approx(200.0)


def test_a_law_that_was_learned_pushes_in_the_source_of_a_run(tmp_path, tiny_args):
    """MJCF has no words for it: it acts at every physics step, in the environments that policies train in."""
    law = {"effect": "learned_force", "target": "hinge", "parameters": {"expression": "a * cos(q)", "a": 3.0}}
    told = written(tmp_path, [law])
    ends = []
    for name, more in (("with", {"effects__known": told}), ("without", {})):
        run = GroundingCLI(tiny_args(tmp_path / name, **more), shows_bars=False).run()
        with closing(run.worlds.training_states(1)) as env:
            env.reset(seed=0)
            for _ in range(5):
                observed = env.step(np.zeros((1, 1)))[0]
            ends.append(observed["state"][0])
    assert ends[0][1] > ends[1][1] + 0.01, "the pole is pushed towards positive angles"


def test_a_run_without_has_its_task_s_source(tmp_path, tiny_args):
    run = GroundingCLI(tiny_args(tmp_path / "run"), shows_bars=False).run()
    assert run.worlds.added_effects == () and known_effects(None, make_task("inverted_pendulum")) == ()


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ([{"effect": "body_mass", "target": "leg", "parameters": {"mass": 9.0}}], "entry 0: .*no body named 'leg'"),
        ([{"effect": "rust", "target": "pole"}], "entry 0: .*'rust'"),
        ({"effect": "body_mass"}, "expected a list of effects, got dict"),
        (
            [{"effect": "numerics", "target": "world", "parameters": {"timestep": 0.01}}],
            "control period of 0.02 s of the",
        ),
    ],
)
def test_what_does_not_fit_the_source_is_said_before_anything_is_trained(tmp_path, tiny_args, capsys, entries, message):
    assert main(["fit", *tiny_args(tmp_path / "run", effects__known=written(tmp_path, entries))]) == 1
    told = capsys.readouterr().err
    assert re.search(message, told), told
    assert not (tmp_path / "run").exists()


def test_a_file_that_is_not_there_is_named(tmp_path, tiny_args, capsys):
    assert main(["fit", *tiny_args(tmp_path / "run", effects__known=tmp_path / "none.yaml")]) == 1
    assert f"effects.known: {tmp_path / 'none.yaml'}: no such file" in capsys.readouterr().err


def test_the_report_tells_what_was_known():
    page = known_section(SimpleNamespace(config={"effects": {"known": TOLD[:2]}}))
    assert "mass 9" in page and "coulomb 0.1, static 0.4, speed 0.2" in page and "joint hinge" in page
    assert known_section(SimpleNamespace(config={"effects": {"discover": True}})) == ""
