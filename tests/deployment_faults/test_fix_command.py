"""`idapt diagnose` reports deployment faults, and takes them out with --fix."""

import json
import shlex

import mujoco
import numpy as np
import pytest

from cli import diagnose_recordings
from cli.main import main
from datamodules import Episode, Trajectories, read_trajectories, write_trajectories

LIMB = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <body name="upper"><joint name="hip" axis="0 1 0" damping="{damping}"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.3" mass="0.6" contype="0" conaffinity="0"/>
      <body name="lower" pos="0 0 -0.3"><joint name="knee" axis="0 1 0" damping="0.05"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.2" mass="0.4" contype="0" conaffinity="0"/>
      </body></body>
  </worldbody>
  <actuator><motor name="hip" joint="hip"/><motor name="knee" joint="knee"/></actuator>
</mujoco>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A nominal model, and recordings of one with more damping whose knee is counted the other way round."""
    folder, rng = tmp_path_factory.mktemp("limb"), np.random.default_rng(0)
    (folder / "nominal.xml").write_text(LIMB.format(damping=0.05))
    model, episodes = mujoco.MjModel.from_xml_string(LIMB.format(damping=0.15)), []
    for _ in range(6):
        data, rows = mujoco.MjData(model), []
        data.qpos[:] = rng.normal(size=2) * 0.5
        actions = np.repeat(rng.uniform(-1, 1, (20, 2)), 4, 0).astype(np.float32)
        rows.append((*data.qpos, *data.qvel))
        for action in actions:
            data.ctrl[:] = action
            mujoco.mj_step(model, data, 4)
            rows.append((*data.qpos, *data.qvel))
        seen = np.array(rows) + rng.normal(size=(81, 4)) * [1e-3, 1e-3, 1e-2, 1e-2]
        episodes.append(Episode(actions, {"qpos": seen[:, :2] * [1, -1], "qvel": seen[:, 2:] * [1, -1]}))
    write_trajectories(folder / "turned.h5", Trajectories(tuple(episodes), 0.02))
    return folder


def diagnose(folder, out, *more):
    """Run the command and read its report."""
    args = ["--model", folder / "nominal.xml", "--data", folder / "turned.h5", "--out", out, "--candidates"]
    assert main(["diagnose", *map(str, args), "joint_damping", *more]) == 0
    return json.loads((out / "report.json").read_text())


def test_with_fix_the_search_goes_on_with_the_mended_recording(folder, tmp_path, capsys):
    report = diagnose(folder, tmp_path, "--fix")
    (fault,) = report["deployment_faults"]["faults"]
    assert (fault["fault"], fault["targets"], fault["estimate"]) == ("joint_sign", ["knee"], -1.0)
    assert report["deployment_faults"]["fixed"]
    (effect,) = [e for e in report["effects"] if e["effect"] == "joint_damping"]
    assert effect["target"] == "hip" and effect["parameters"]["damping"]["estimate"] == pytest.approx(0.15, rel=0.1)
    mended, faulty = read_trajectories(tmp_path / "mended.h5"), read_trajectories(folder / "turned.h5")
    for e, o in zip(mended, faulty, strict=True):
        np.testing.assert_allclose(e.observations["qpos"], o.observations["qpos"] * [1, -1], atol=1e-6)
    page, said = (tmp_path / "report.html").read_text(), capsys.readouterr().out
    assert "Deployment faults" in page and "multiply the recorded position and velocity by -1" in page
    assert "the sign of the joint is turned (knee)" in said and "mended.h5" in said


def test_without_fix_the_faults_are_told_and_nothing_is_changed(folder, tmp_path, capsys):
    report = diagnose(folder, tmp_path)
    assert not report["deployment_faults"]["fixed"] and len(report["deployment_faults"]["faults"]) == 1
    assert not (tmp_path / "mended.h5").exists()
    assert "--fix" in capsys.readouterr().out
    assert report["next_experiment"].startswith("nothing yet: give the same command with --fix first")


def test_the_command_with_fix_is_told_before_the_search_and_first_of_all_on_the_page(
    folder, tmp_path, capsys, caplog, monkeypatch
):
    caplog.set_level("INFO")
    search, told = diagnose_recordings.diagnose, []

    def begin(*args, **kwargs):
        told.append(capsys.readouterr().out)
        told.append(caplog.text)
        return search(*args, **kwargs)

    monkeypatch.setattr(diagnose_recordings, "diagnose", begin)
    report = diagnose(folder, tmp_path)
    args = ["--model", folder / "nominal.xml", "--data", folder / "turned.h5", "--out", tmp_path, "--candidates"]
    command = shlex.join(["idapt", "diagnose", *map(str, args), "joint_damping", "--fix"])
    assert f"The first thing to do: {command}" in told[0] and command in told[1]
    assert command in report["next_experiment"]
    page = (tmp_path / "report.html").read_text()
    assert f"First take the deployment faults out: {command}" in page and "sensors are so good" not in page


def test_fix_needs_recordings_of_positions(folder, tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["diagnose", "--run", str(folder), "--data", str(folder / "turned.h5"), "--out", str(tmp_path), "--fix"])
    assert "--fix mends recordings of positions" in capsys.readouterr().err


def test_mended_recordings_of_before_are_not_written_over_while_they_are_read(tmp_path, capsys):
    read = [str(tmp_path / f"mended_{i}.h5") for i in range(2)]
    assert main(["diagnose", "--model", "m.xml", "--data", *read, "--out", str(tmp_path), "--fix"]) == 1
    assert "mended_0.h5: --out is also read from" in " ".join(capsys.readouterr().err.split())
