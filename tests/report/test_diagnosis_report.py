"""`idapt diagnose` from the command line: what it writes, what it says, and what it says of bad input."""

import json
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from conftest import ROOT
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from cli.main import main
from datamodules import Episode, Trajectories, write_trajectories
from idapt_pl.diagnosis.answer.changes import ChangeFinding, ChangeReport
from idapt_pl.diagnosis.answer.law_result import LawFinding, LawReport
from idapt_pl.diagnosis.answer.repaired import repair_model
from idapt_pl.diagnosis.answer.result import (
    Alternative,
    DiagnosisResult,
    EffectEstimate,
    ErrorTable,
    ParameterEstimate,
    RejectedCandidate,
    Verdict,
)
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.effects import effect_from_dict
from idapt_pl.effects.wording import format_estimate, format_number, phrase_at, unit_at
from idapt_pl.prediction.model import read_model
from idapt_pl.report.changed_settings import span
from idapt_pl.report.diagnosis_files import write_diagnosis
from idapt_pl.report.diagnosis_page import effects_section
from idapt_pl.report.diagnosis_wording import (
    episode_list,
    estimate_cells,
    headline,
    rest_explained_by,
    verdict_in_words,
)
from idapt_pl.report.html import document
from idapt_pl.report.law_section import law_sentences
from idapt_pl.report.minute_section import differences_in_words

NOMINAL, HIDDEN = 0.01, 0.06

SWING = """
<mujoco model="swing">
  <option timestep="0.005"/>
  <worldbody>
    <body name="rod" pos="0 0 1">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="{damping}"/>
      <geom name="bar" type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.5"/>
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>"""
MOTOR = '<motor name="motor" joint="shoulder" ctrlrange="-2 2"/>'


def record(damping, motor=MOTOR, episodes=4, steps=100, noise=(5e-4, 5e-3)):
    """Noisy episodes of the swing, stepped by hand; torques are held for 0.02 s."""
    model = mujoco.MjModel.from_xml_string(SWING.format(damping=damping, actuator=motor))
    data, rng, made = mujoco.MjData(model), np.random.default_rng(0), []
    time = 0.02 * np.arange(steps)[:, None]
    for _ in range(episodes):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = rng.uniform(0.5, 1.5)
        waves = np.sin(2 * np.pi * rng.uniform(0.3, 2, 3) * time + rng.uniform(0, 6, 3))
        actions = 0.5 * waves.sum(1, keepdims=True)[:, : model.nu].astype(np.float32)
        rows = [(*data.qpos, *data.qvel)]
        for action in actions:
            data.ctrl[:] = action
            for _ in range(4):
                mujoco.mj_step(model, data)
            rows.append((*data.qpos, *data.qvel))
        seen = np.array(rows) + rng.normal(size=(steps + 1, 2)) * noise
        made.append(Episode(actions, {"qpos": seen[:, :1], "qvel": seen[:, 1:]}))
    return Trajectories(tuple(made), 0.02, "a swing")


def changed(data, **observations):
    """The same recordings with other observations in the second episode (None takes one out)."""
    first, second, *rest = data.episodes
    seen = {k: v for k, v in (second.observations | observations).items() if v is not None}
    return Trajectories((first, Episode(second.actions, seen), *rest), data.dt)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    """A nominal model, recordings with hidden damping, and recordings with none."""
    folder = tmp_path_factory.mktemp("swing")
    (folder / "nominal.xml").write_text(SWING.format(damping=NOMINAL, actuator=MOTOR))
    write_trajectories(folder / "damped.h5", record(HIDDEN))
    write_trajectories(folder / "same.h5", record(NOMINAL))
    return folder


def run(folder, data, out, *more):
    args = ["--model", folder / "nominal.xml", "--data", folder / data, "--out", out, *more]
    return main(["diagnose", *map(str, args)])


@pytest.fixture(scope="module")
def damped(workspace):
    """Output folder of a diagnosis that finds the damping."""
    out = workspace / "damped"
    assert run(workspace, "damped.h5", out) == 0
    return out


# --- what is written ------------------------------------------------------------------------------------


def test_everything_is_written(damped):
    names = {p.name for p in damped.iterdir()}
    assert {"report.json", "report.html", "patched.xml", "effects.yaml"} <= names
    assert any(n.startswith("events.out.tfevents") for n in names)
    assert not [n for n in names if n.endswith(".tmp")]


def test_report_json_has_the_keys_of_its_schema_and_the_hidden_effect(damped):
    report = json.loads((damped / "report.json").read_text())
    assert report["schema"] == "idapt.diagnosis/1"
    assert report["verdict"] == "effects_found"
    assert {"error", "effects", "candidates", "signature", "next_experiment", "runtime_s"} <= set(report)
    assert {
        "metric", "unit", "split", "horizon_s", "before", "after", "noise_floor", "ceiling", "per_channel",
    } <= set(report["error"])  # fmt: skip
    (effect,) = report["effects"]
    assert (effect["effect"], effect["target"]) == ("joint_damping", "shoulder")
    assert {"parameters", "error_after", "equivalent"} <= set(effect)
    damping = effect["parameters"]["damping"]
    assert damping["nominal"] == NOMINAL and damping["unit"] == "N·m·s/rad", "the unit of a hinge, not of either kind"
    assert damping["estimate"] == pytest.approx(HIDDEN, rel=0.03)
    low, high = damping["ci95"]
    assert low <= damping["estimate"] <= high
    for candidate in report["candidates"]:
        assert {"effect", "target", "score", "held_out_gain", "rejected_because"} <= set(candidate)
    assert report["error"]["after"] < 0.2 * report["error"]["before"]
    assert report["error"]["after"] < 1.5, "the right model leaves more than the noise"


def test_page_is_self_contained_and_says_what_was_found(damped):
    html = (damped / "report.html").read_text(encoding="utf-8")
    without_namespaces = re.sub(r'xmlns(:\w+)?="[^"]*"', "", html)
    assert "http" not in without_namespaces
    assert not re.search(r"<(script|link|iframe|img)\b|@import|url\((?!#)|\bsrc=", html)
    assert re.search(r"viscous friction \(damping\) on joint shoulder, 0\.0(59|60)", html)
    assert "of the removable error on episodes not used for fitting" in html
    assert html.count("<svg") == 2
    assert "<metadata" not in html and "<!DOCTYPE svg" not in html
    assert 'class="cut">-      &lt;joint name=&quot;shoulder&quot; damping=&quot;0.01&quot;' in html
    for words in ("noise floor", "ceiling", "95 % interval", "N·m·s/rad", "accepted", "Candidates"):
        assert words in html, words


def test_page_fetches_nothing_even_for_hostile_names(damped, workspace, tmp_path):
    data = record(HIDDEN)
    found = diagnose(read_model(workspace / "nominal.xml"), data, candidates=["joint_damping"])
    for _ in range(2):
        write_diagnosis(found, tmp_path, "<script src=x>.xml", "a&b.h5")
    assert len(list(tmp_path.glob("events.out.tfevents.*"))) == 1, "events of an earlier run are removed"
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<script" not in html and "a&amp;b.h5" in html


def test_patched_model_loads_and_has_the_damping_changed(damped):
    patched = mujoco.MjModel.from_xml_path(str(damped / "patched.xml"))
    assert patched.dof_damping[0] == pytest.approx(HIDDEN, rel=0.03)
    assert patched.opt.timestep == 0.005


def test_effects_file_makes_the_same_model_and_can_be_declared(damped, workspace, tmp_path):
    entries = yaml.safe_load((damped / "effects.yaml").read_text())
    effects = [effect_from_dict(e) for e in entries]
    assert [e.to_dict() for e in effects] == entries
    spec = mujoco.MjSpec.from_file(str(workspace / "nominal.xml"))
    for e in effects:
        e.apply(spec)
    patched = mujoco.MjModel.from_xml_path(str(damped / "patched.xml"))
    assert spec.compile().dof_damping == pytest.approx(patched.dof_damping, rel=1e-4)
    out = tmp_path / "again"
    more = ("--effects", damped / "effects.yaml", "--candidates", "joint_damping", "joint_frictionloss")
    assert run(workspace, "damped.h5", out, *more) == 0
    report = json.loads((out / "report.json").read_text())
    assert report["verdict"] == "no_missing_effect"
    assert report["declared"] == entries
    assert yaml.safe_load((out / "effects.yaml").read_text()) == []
    declared = mujoco.MjModel.from_xml_path(str(out / "patched.xml"))
    assert declared.dof_damping == pytest.approx(patched.dof_damping, rel=1e-4)


def test_tensorboard_has_errors_estimates_and_figures(damped):
    events = EventAccumulator(str(damped)).Reload()
    tags = events.Tags()
    assert {"error/before", "error/after", "error/noise_floor", "effects/joint_damping/shoulder/damping"} <= set(
        tags["scalars"]
    )
    assert set(tags["images"]) == {"prediction", "residual_by_channel"}
    assert events.Scalars("effects/joint_damping/shoulder/damping")[0].value == pytest.approx(HIDDEN, rel=0.03)


def test_nothing_missing_is_said(workspace, tmp_path, capsys):
    assert run(workspace, "same.h5", tmp_path / "out") == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (report["verdict"], report["effects"]) == ("no_missing_effect", [])
    assert "No missing effect" in capsys.readouterr().out
    assert "Nothing is missing" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "patched.xml")).dof_damping[0] == NOMINAL


def test_terminal_shows_verdict_table_and_where_the_report_is(workspace, tmp_path, capsys):
    assert run(workspace, "damped.h5", tmp_path, "--candidates", "joint_damping", "--max-effects", "1") == 0
    printed = capsys.readouterr().out
    for words in ("viscous friction", "before", "after", "noise floor", "ceiling", str(tmp_path / "report.html")):
        assert words in printed, words


def test_passive_recordings_are_valid(tmp_path):
    (tmp_path / "nominal.xml").write_text(SWING.format(damping=NOMINAL, actuator=""))
    write_trajectories(tmp_path / "free.h5", record(HIDDEN, motor=""))
    assert run(tmp_path, "free.h5", tmp_path / "out", "--candidates", "joint_damping", "joint_frictionloss") == 0
    (effect,) = json.loads((tmp_path / "out" / "report.json").read_text())["effects"]
    assert effect["parameters"]["damping"]["estimate"] == pytest.approx(HIDDEN, rel=0.05)


# --- the repaired model ---------------------------------------------------------------------------------

BLOCKS = """
<mujoco><compiler meshdir="parts"/><include file="assets.xml"/>
  <worldbody><body name="block"><freejoint/><geom type="mesh" mesh="wedge"/>
    <body><joint type="slide"/><geom size="0.1"/></body></body></worldbody>
  <actuator><motor joint="{joint}"/></actuator></mujoco>"""
WEDGE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def blocks(tmp_path):
    """A model with an included file and a mesh, in folders of its own."""
    home = tmp_path / "robot"
    (home / "parts").mkdir(parents=True)
    (home / "parts" / "wedge.obj").write_text(WEDGE)
    (home / "assets.xml").write_text('<mujoco><asset><mesh name="wedge" file="wedge.obj"/></asset></mujoco>')
    (home / "nominal.xml").write_text(BLOCKS.format(joint="x").replace('type="slide"', 'type="slide" name="x"'))
    return home / "nominal.xml"


@pytest.mark.parametrize("folder", [".", "out", "runs/first"])
def test_repaired_model_finds_its_meshes_from_another_folder(folder, blocks, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    spec, out = read_model(blocks.relative_to(tmp_path)), Path(folder)
    heavier = effect_from_dict({"effect": "body_mass", "target": "block", "parameters": {"mass": 3.0}})
    out.mkdir(parents=True, exist_ok=True)
    (out / "patched.xml").write_text(repair_model(spec, (heavier,), out).patched)
    loaded = mujoco.MjModel.from_xml_path(str(out / "patched.xml"))
    heavier.apply(spec)
    wanted = spec.compile()
    for name in ("body_mass", "body_ipos", "body_inertia", "geom_pos", "geom_quat"):
        assert getattr(loaded, name) == pytest.approx(getattr(wanted, name), rel=1e-4, abs=1e-6), name


def test_what_mjcf_cannot_say_is_named_and_changes_nothing(blocks, tmp_path):
    spec = read_model(blocks)
    effects = tuple(
        effect_from_dict(e)
        for e in (
            {"effect": "joint_cogging", "target": "x", "parameters": {"sine": 0.1}},
            {"effect": "joint_damping", "target": "x", "parameters": {"damping": 0.5}},
            {"effect": "sensor_bias", "target": "x", "parameters": {"bias": 0.1}},
        )
    )
    repaired = repair_model(spec, effects, tmp_path)
    assert [e.name for e in repaired.unsaid] == ["joint_cogging", "sensor_bias"]
    added = [line for line in repaired.difference() if line.startswith("+ ")]
    assert len(added) == 1 and 'damping="0.5"' in added[0]


def test_elements_without_a_name_get_one(blocks):
    spec = read_model(blocks)
    assert [j.name for j in spec.joints] == ["joint0", "x"]
    assert [b.name for b in spec.bodies] == ["world", "block", "body2"]
    assert [a.name for a in spec.actuators] == ["x"], "an actuator is called like the joint that it alone drives"


# --- words ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "interval", "shown"),
    [
        (10.1234, (9.81, 10.42), ("10.1", "9.8 to 10.4")),
        (0.0599, (0.05968, 0.0602), ("0.0599", "0.0597 to 0.0602")),
        (12345.0, (12000.0, 12700.0), ("12300", "12000 to 12700")),
        (0.005, None, ("0.005", "")),
        ("RK4", None, ("RK4", "")),
    ],
)
def test_digits_follow_the_interval(value, interval, shown):
    assert format_estimate(value, interval) == shown


def test_numbers_have_sensible_digits():
    assert [format_number(v) for v in (0.0, 1.0249, 23.68, 1234.5, 0.000754, float("nan"))] == [
        "0", "1.02", "23.7", "1234", "0.000754", "-",
    ]  # fmt: skip


def test_effects_and_units_are_those_of_their_target(blocks):
    assert phrase_at("joint_frictionloss", "slider") == "dry friction on joint slider"
    assert phrase_at("body_mass", "*") == "mass of all bodies"
    assert phrase_at("gravity_direction", "world") == "direction of gravity"
    swing = mujoco.MjModel.from_xml_string(SWING.format(damping=1, actuator=MOTOR))
    assert unit_at(swing, "shoulder", "N·m or N") == "N·m"
    assert unit_at(read_model(blocks).compile(), "x", "N·m or N") == "N"


def made_result(verdict, effects):
    error = ErrorTable(5, 0.1, (0,), (1,), 3.0, 1.1, 1.0, 1.5, 0.97, 0.0, {})
    return DiagnosisResult(Verdict(verdict), error, effects, (), (), "", "")


@pytest.mark.parametrize(("after", "gain", "told"), [(3.0, 7.0, True), (3.0, 3.0, False), (1.2, 7.0, False)])
def test_what_would_explain_the_rest_but_is_not_sure_is_told(blocks, after, gain, told):
    result = made_result("no_missing_effect", [])
    unsure = RejectedCandidate(
        "joint_range", "x", {"upper": 0.5}, {}, 1, 9.0, gain, "gain 7 ± 6 is not surely positive"
    )
    result = replace(result, error=replace(result.error, after=after), candidates=[unsure])
    said = " ".join(verdict_in_words(result, read_model(blocks).compile()))
    expected = "Nearly named: an end stop of joint x (upper 0.5). It would take 88 % of the rest off, but: gain 7 ± 6"
    assert (expected in said) == told and ("Nearly" in said) == told
    found = replace(result, verdict=Verdict.UNEXPLAINED_RESIDUAL, effects=[FRICTION])
    assert "Nearly" not in " ".join(verdict_in_words(found, read_model(blocks).compile())), "its gain is of before"
    beyond = replace(result, candidates=[replace(unsure, implausible=True)])
    assert "Nearly" not in " ".join(verdict_in_words(beyond, read_model(blocks).compile()))


FRICTION = EffectEstimate(
    "joint_frictionloss", "shoulder", {"frictionloss": ParameterEstimate(0.0, 10.1, (9.8, 10.4), "N·m or N")},
    equivalent=(Alternative("actuator_gain", "motor", {"gain": 0.8}, ""),),
)  # fmt: skip
FINER = EffectEstimate("numerics", "world", {"timestep": ParameterEstimate(0.002, 0.0004, None, "s")}, equivalent=())


@pytest.mark.parametrize(
    ("verdict", "effects", "words"),
    [
        (
            "effects_found",
            [FRICTION],
            "The model lacks one effect: dry friction on joint shoulder, 10.1 N·m (95 %: 9.8",
        ),
        ("effects_found", [FRICTION], "removes 97 % of the removable error on episodes not used for fitting"),
        ("effects_found", [FRICTION], "cannot tell dry friction on joint shoulder from gain of actuator motor."),
        ("effects_found", [FRICTION, FRICTION], "lacks 2 effects"),
        ("no_missing_effect", [], "No missing effect: none of the effects tried"),
        ("no_missing_effect", [FINER], "ask for other numerics: time step and integrator of the simulation, 0.0004 s"),
        ("unexplained_residual", [], "no effect of the library explains it"),
        ("unexplained_residual", [FRICTION], "Part of the error stays unexplained"),
        ("insufficient_excitation", [], "cannot tell whether something is missing"),
    ],
)
def test_every_verdict_has_its_sentence(verdict, effects, words):
    swing = mujoco.MjModel.from_xml_string(SWING.format(damping=1, actuator=MOTOR))
    assert words in " ".join(verdict_in_words(made_result(verdict, effects), swing))


def test_an_error_that_stays_is_no_change():
    """What no held-out episode shows is found by the others."""
    swing = mujoco.MjModel.from_xml_string(SWING.format(damping=1, actuator=MOTOR))
    result = made_result("effects_found", [FRICTION])
    stays = replace(result, error=replace(result.error, after=result.error.before, removed_share=0.0))
    said = " ".join(verdict_in_words(stays, swing))
    assert "adding it changes nothing: the error stays at" in said and "removes" not in said


WAVE = "a*sin(b*q)"
LAW = EffectEstimate(
    "learned_force", "shoulder", {
        "a": ParameterEstimate(0.0, 0.5, (0.4, 0.6), "N·m"), "b": ParameterEstimate(None, 2.35, (2.3, 2.4), "1/rad"),
    },
    {"expression": WAVE}, error_after=1.0, error_without=3.0,
)  # fmt: skip


def test_the_widest_table_may_break_intervals_and_heads_to_fit_its_card():
    swing = mujoco.MjModel.from_xml_string(SWING.format(damping=1, actuator=MOTOR))
    page = document("", [effects_section(made_result("effects_found", [FRICTION]), swing)], "#000")
    assert re.search(r"<td>9\.\d+ to 10\.\d+</td>", page) and '<th class="n">in the model</th>' in page
    assert re.findall(r"(\S*) \{[^}]*white-space: nowrap", page) == ["td.n"], "all else wraps"


def test_what_a_model_has_no_number_for_is_a_dash_and_instead_of_nothing():
    swing = mujoco.MjModel.from_xml_string(SWING.format(damping=1, actuator=MOTOR))
    said = " ".join(verdict_in_words(made_result("effects_found", [LAW]), swing))
    assert "The model lacks one effect" in said and "b 2.35" in said
    assert "instead of" not in said
    assert [cells[-1] for cells in estimate_cells(LAW, swing)] == ["0", "-"]
    assert EffectEstimate.from_dict(json.loads(json.dumps(LAW.to_dict()))) == LAW


@pytest.mark.parametrize("mending", ["", "idapt diagnose --fix"])
def test_faults_that_were_left_are_no_good_sensors(mending):
    swing = mujoco.MjModel.from_xml_string(SWING.format(damping=1, actuator=MOTOR))
    result = made_result("unexplained_residual", [])
    by_force = replace(result, error=replace(result.error, unexplained={"shoulder": 0.2}), mending=mending)
    said = " ".join(verdict_in_words(by_force, swing))
    assert ("The sensors are so good" in said) == (not mending) and "models are judged by the force" in said.lower()
    assert "1 is, in N·m or N: 0.2 at shoulder" in said


def with_a_law(verdict, effects, share):
    """A result with a law of a force that is so large beside the usual one."""
    result = made_result(verdict, [*effects, LAW])
    law = LawFinding("shoulder", WAVE, "0.5·sin(2.35·q)", "N·m", {}, ("q",), 0.9, (), 0.25 * share, share)
    return replace(result, laws=LawReport(3.0, 1.0, [law], None, (), (), "", 2.0))


@pytest.mark.parametrize("verdict", ["effects_found", "unexplained_residual"])
@pytest.mark.parametrize(("share", "told"), [(0.4, "at most 0.1 N·m, 40 % of the usual force there"), (0.004, "")])
def test_a_law_is_told_by_its_size_and_is_no_headline_where_that_is_nothing(verdict, share, told):
    swing = mujoco.MjModel.from_xml_string(SWING.format(damping=1, actuator=MOTOR))
    result = with_a_law(verdict, [FRICTION], share)
    shortly, said = differences_in_words(result, swing), " ".join(verdict_in_words(result, swing))
    assert "dry friction on joint shoulder" in shortly and "dry friction on joint shoulder" in said
    if told:
        assert told in shortly and told in said
    else:
        assert " law" not in shortly + said + headline(result), "it is next to nothing"
    (sentence,) = law_sentences(result.laws)
    assert "% of the usual force there" in sentence and ("next to nothing" in sentence) == (not told)


def test_a_quick_look_does_not_say_that_nothing_known_explains_the_rest():
    result = made_result("unexplained_residual", [FRICTION])
    assert headline(result) == "Something is still missing that no known effect explains"
    assert headline(replace(result, not_tried=("laws",))) == "Something is missing that a quick look does not explain"


def test_what_a_law_or_a_change_explains_is_not_called_unexplained():
    unexplained = made_result("unexplained_residual", [FRICTION])
    law = LawFinding("shoulder", "-a*max(v, 0)", "-0.5 max(v, 0)", "N·m", {}, ("v",), 0.9, (), 0.5, 0.4)
    found = LawReport(3.0, 1.0, [law], None, (), (), "", 2.0)
    change = ChangeFinding("actuator_gain", "*", "gain", "1", "drift_over", 1.0, 0.7, None, None, 0.001, 0.9, ())
    for rest, said in (
        ("law", replace(unexplained, laws=found)), ("change", replace(unexplained, changes=ChangeReport(3, [change]))),
        ("", unexplained), ("", replace(unexplained, laws=replace(found, after=2.0))),
        ("", replace(unexplained, changes=ChangeReport(3, [replace(change, removed_share=0.2)]))),
        ("", replace(made_result("effects_found", [FRICTION]), changes=ChangeReport(3, [change]))),
    ):  # fmt: skip
        assert rest_explained_by(said) == rest
        assert headline(said).startswith("A law of force was learned") == (rest == "law")
        assert (headline(said) == "What the model lacks does not stay the same") == (rest == "change")


# --- bad input ------------------------------------------------------------------------------------------


def refused(capsys, folder, args, code=1):
    """The message of a run that must fail without a traceback and without output."""
    out = folder / "nothing"
    values = {"--model": folder / "nominal.xml", "--data": folder / "damped.h5", "--out": out} | args
    listed = [str(v) for k, vs in values.items() for v in (k, *(vs if isinstance(vs, list) else [vs]))]
    try:
        got = main(["diagnose", *listed])
    except SystemExit as end:
        got = end.code
    message = " ".join(capsys.readouterr().err.split())
    assert got == code, message
    assert "Traceback" not in message and len(message) < 1500
    assert not out.exists(), "a failed run leaves no folder"
    return message


def nan_in_row_7(data):
    qpos = data.episodes[1].observations["qpos"].copy()
    qpos[7] = np.nan
    return changed(data, qpos=qpos)


def with_dt(data, dt):
    return Trajectories(data.episodes, dt)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda d: changed(d, qpos=np.zeros((101, 3))), ("episode_1", "qpos", "(101, 3)", "1")),
        (lambda d: changed(d, qvel=np.zeros((101, 2))), ("episode_1", "qvel", "(101, 2)", "1")),
        (lambda d: changed(d, qpos=None), ("episode_1", "qpos", "qvel")),
        (nan_in_row_7, ("episode_1", "qpos", "NaN", "row 7")),
        (lambda d: record(HIDDEN, motor=""), ("episode_0", "actions", "(100, 0)", "1 actuators")),
        (lambda d: record(HIDDEN, episodes=1, steps=60), ("1 episode", "at least two")),
        (lambda d: record(HIDDEN, episodes=2, steps=4), ("2 episodes", "8 steps", "too few")),
        (lambda d: with_dt(d, 0.0), ("dt", "0")),
        (lambda d: with_dt(d, float("nan")), ("dt", "nan")),
    ],
    ids=["qpos", "qvel", "no-qpos", "nan", "no-actions", "one-episode", "too-few-steps", "no-dt", "nan-dt"],
)
def test_unusable_recordings_are_named(edit, words, workspace, capsys, tmp_path):
    path = tmp_path / "bad.h5"
    write_trajectories(path, edit(record(HIDDEN)))
    message = refused(capsys, workspace, {"--data": path})
    for word in words:
        assert word in message, message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, ("no such file",)),
        ("<mujoco><worldbody><geom sise='1'/></worldbody></mujoco>", ("MuJoCo", "unrecognized attribute", "sise")),
        ("hello", ("MuJoCo", "XML")),
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", ("MuJoCo", "mass and inertia")),
        ("<mujoco/>", ("no joints",)),
    ],
    ids=["missing", "schema", "no-xml", "massless", "empty"],
)
def test_unreadable_models_are_named(content, words, workspace, capsys, tmp_path):
    path = tmp_path / "bad.xml"
    if content is not None:
        path.write_text(content)
    message = refused(capsys, workspace, {"--model": path})
    for word in (str(path), *words):
        assert word in message, message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, ("no such file",)),
        ("- {effect: [", ("not valid YAML",)),
        ("!!python/object/apply:os.getcwd []", ("not valid YAML",)),
        ("effect: joint_damping", ("list of effects", "dict")),
        ("- {effect: body_mass, target: rod, parameters: {mass: 1}}\n- {effect: jam}", ("entry 1", "jam", "body_mass")),
        ("- {effect: joint_damping, target: elbow, parameters: {damping: 1}}", ("entry 0", "elbow", "shoulder")),
        ("- {effect: joint_damping, target: shoulder, parameters: {amount: 1}}", ("entry 0", "damping", "amount")),
        ("- {effect: joint_damping, target: shoulder, parameters: {damping: -1}}", ("entry 0", "-1", "outside")),
        ("- {effect: joint_damping, target: shoulder, parameters: }", ("entry 0", "parameters")),
        ("- {effect: [a], target: shoulder}", ("entry 0", "name")),
        (
            "- {effect: learned_force, target: shoulder, parameters: {expression: a*motor, b: 1}}",
            ("entry 0", "has the coefficients a"),
        ),
        ("- 3", ("entry 0", "keys")),
    ],
)  # fmt: skip
def test_bad_effects_files_are_named(content, words, workspace, capsys, tmp_path):
    path = tmp_path / "declared.yaml"
    if content is not None:
        path.write_text(content)
    message = refused(capsys, workspace, {"--effects": path})
    for word in (str(path), *words):
        assert word in message, message


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        ({"--data": "none.h5"}, 1, ("none.h5", "no such file")),
        ({"--data": "nominal.xml"}, 1, ("nominal.xml", "HDF5")),
        ({"--fit": ["0", "9"]}, 1, ("no episode 9", "0 to 3")),
        ({"--hold-out": ["-1"]}, 1, ("no episode -1",)),
        ({"--fit": ["0", "1"], "--hold-out": ["1"]}, 1, ("[1]", "both")),
        ({"--candidates": ["joint_jam"]}, 1, ("joint_jam", "joint_damping")),
        ({"--max-effects": "0"}, 2, ("--max-effects",)),
        ({"--seed": "x"}, 2, ("--seed",)),
    ],
)
def test_bad_options_are_named(args, code, words, workspace, capsys, monkeypatch):
    monkeypatch.chdir(workspace)
    message = refused(capsys, workspace, args, code)
    for word in words:
        assert word in message, message


def test_out_must_not_be_a_file(workspace, capsys):
    assert run(workspace, "damped.h5", workspace / "nominal.xml") == 1
    assert "--out is a file" in capsys.readouterr().err


def test_help_teaches(capsys):
    with pytest.raises(SystemExit) as end:
        main(["diagnose", "--help"])
    assert end.value.code == 0
    printed = capsys.readouterr().out
    for words in ("examples:", "idapt diagnose --model nominal.xml", "--hold-out", "report.html"):
        assert words in printed, words
    assert "(default: None)" not in printed
    assert "idapt diagnose" in (ROOT / "docs" / "guide" / "diagnose.md").read_text()


def test_episodes_are_listed_where_they_are_few():
    assert episode_list([3]) == "episode 3" and episode_list([0, 2]) == "episodes 0, 2"
    assert episode_list(range(145)) == "145 episodes"


def test_intervals_of_settings_have_the_digits_that_tell_them_apart():
    assert span("1.20001", ["1.1996", "1.2004"]) == "1.1996 to 1.2004"
    assert span("0.3 1", ["0.31 1", "0.29 1"]) == "0.290 to 0.310, 1" and span("0.3", ["0.3"]) == "" == span("x", ["y"])
