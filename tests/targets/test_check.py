"""What `idapt check` finds before a run: axes, signs, units and cameras."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import yaml
from test_targets import LAB, written

from cli.check import beyond_bounds
from cli.main import main
from datamodules import Episode, Trajectories, write_trajectories
from idapt_pl.envs import ActionMap
from idapt_pl.targets.action_units import action_units
from idapt_pl.targets.trial_moves import CELLS, TrialMoves, apparent_motion, crossed, suspicions, told_pace


def blob(x, y, side=32, colour=(200, 80, 40), back=(20, 60, 20)):
    """A soft spot at (x, y)."""
    rows, columns = np.mgrid[:side, :side]
    weight = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 12)[..., None]
    return (np.array(back) * (1 - weight) + np.array(colour) * weight).astype(np.uint8)


@pytest.mark.parametrize(("right", "down"), [(1.0, 0.0), (-0.7, 0.0), (0.0, 0.8), (0.5, -0.5)])
def test_the_motion_of_what_moves_is_found_whatever_it_looks_like(right, down):
    for look in ({}, {"colour": (10, 10, 10), "back": (240, 240, 250)}):
        frames = [blob(14 + t * right, 16 + t * down, **look) for t in range(6)]
        field = apparent_motion(frames)
        most = field.reshape(-1, 2)[np.linalg.norm(field, axis=-1).argmax()]
        np.testing.assert_allclose(most, [5 * right, 5 * down], atol=1.5)


def test_what_is_as_bright_as_what_is_behind_it_is_seen_to_move():
    frames = [blob(12 + t, 16, colour=(150, 100, 50), back=(50, 100, 150)) for t in range(6)]
    assert np.linalg.norm(apparent_motion(frames), axis=-1).max() > 3


def test_nothing_moves_in_still_images():
    noise = np.random.default_rng(0).integers(-2, 3, (6, 32, 32, 3))
    assert not apparent_motion([blob(14, 16) + n for n in noise]).any()


def field(*moving):
    """Motions in cells: (row, column, right, down)."""
    made = np.zeros((CELLS, CELLS, 2))
    for row, column, right, down in moving:
        made[row, column] = right, down
    return made


SHOULDER, ELBOW = field((2, 1, 4.0, 0.0), (1, 1, 2.0, 0.0)), field((1, 2, 0.5, 3.0))
SOURCE = np.array([SHOULDER, ELBOW])
NAMES = ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ([SHOULDER + 0.1, 0.7 * ELBOW], []),
        ([-SHOULDER, ELBOW], ["shoulder moves the other way"]),
        ([-SHOULDER, -ELBOW], ["shoulder moves the other way", "elbow moves the other way"]),
        ([ELBOW, SHOULDER], ["shoulder and elbow seem to be exchanged"]),
        ([10 * SHOULDER, ELBOW], ["shoulder moves things 10 times as far"]),
        ([SHOULDER, field((1, 2, 3.0, 0.0))], ["elbow moves things in another direction"]),
        ([-SHOULDER[::-1, ::-1], -ELBOW[::-1, ::-1]], ["the target's image were upside down"]),
        ([SHOULDER[:, ::-1] * (-1, 1), ELBOW[:, ::-1] * (-1, 1)], ["mirrored left to right"]),
        ([SHOULDER[::-1] * (1, -1), ELBOW[::-1] * (1, -1)], ["mirrored top to bottom"]),
    ],
)
def test_what_is_crossed_is_said_and_nothing_else(target, said):
    found = crossed(SOURCE, np.array(target), (0, 1), NAMES)
    assert len(found) == len(said) and all(part in sentence for part, sentence in zip(said, found, strict=True))


@pytest.mark.parametrize(
    ("source", "target", "said"),
    [(None, None, False), (None, 2, True), (None, 3, False), (8, 7, False), (10, 4, True), (4, None, False)],
)
def test_a_target_whose_episodes_end_much_sooner_is_told(source, target, said):
    a, b = (replace(moves(SOURCE), ended=ended) for ended in (source, target))
    assert any("control step" in sentence for sentence in suspicions(a, b, NAMES)) == said


@pytest.mark.parametrize(("target", "said"), [(1, True), (3, True), (4, False), (8, False), (None, False)])
def test_episodes_shorter_than_a_frame_stack_are_told(target, said):
    a, b = (replace(moves(SOURCE), ended=ended) for ended in (target, target))  # the source's are as short
    found = suspicions(a, b, NAMES, frame_stack=4)
    assert found == [] or (f"ends after {target} control step" in found[0] and "has 4 images" in found[0])
    assert bool(found) == said


def moves(motion, seen=(True, True), start=None):
    shown = np.array([blob(8, 16) if s else blob(16, 16) for s in seen])
    other = np.array([blob(24, 16) if s else blob(16, 16) for s in seen])
    return TrialMoves(blob(16, 16) if start is None else start, shown, other, np.array(motion, float), 24)


def test_one_reversed_motor_that_looks_like_a_mirror_is_named_beside_it():
    """A camera that is turned in its place would make the policy go the wrong way."""
    sideways, up = np.zeros((2, CELLS, CELLS, 2))
    sideways[:, 1:3, 0], up[1:3, :, 1] = 5.0, 5.0
    (said,) = crossed(np.array([sideways, up]), np.array([-sideways, up]), (0, 1), NAMES)
    assert "mirrored left to right" in said and f"; or {NAMES[0]} moves the other way" in said


def test_what_moves_too_little_to_be_compared_is_said_to():
    little = np.random.default_rng(0).normal(size=SHOULDER.shape) * 0.2
    (said,) = crossed(np.array([0.3 * SHOULDER, ELBOW]), np.array([little, ELBOW]), (0, 1), NAMES)
    assert said == "shoulder moves too little to compare where to: push further, with --share 1"


def test_what_cannot_be_seen_is_said():
    still, flat = moves([SHOULDER, 0 * ELBOW], (True, False)), np.full((32, 32, 3), 7, np.uint8)
    assert suspicions(moves(SOURCE), moves(SOURCE), NAMES) == [] == suspicions(moves(SOURCE), None, NAMES)
    assert suspicions(still, None, NAMES) == ["elbow moves nothing that the source's camera sees"]
    assert suspicions(moves(SOURCE), still, NAMES) == ["elbow moves nothing that the target's camera sees"]
    assert "nearly of one colour" in suspicions(moves(SOURCE), moves(SOURCE, start=flat), NAMES)[0]
    red = np.full((32, 32, 3), (250, 10, 10), np.uint8)
    (seen,) = suspicions(moves(SOURCE), None, NAMES, red)
    assert "the target's image is nearly of one colour" in seen, "though it was not moved"
    assert suspicions(moves(SOURCE), None, NAMES, blob(4, 4)) == []


@pytest.mark.parametrize(
    ("turned", "said"),
    [
        (
            lambda a: -a[::-1, ::-1],
            "the other way: see the sign of target.actions.scale; or the target's image is upside",
        ),
        (lambda a: a[:, ::-1] * (-1, 1), "mirrored left to right. One actuator that is seen does not tell which"),
    ],
)
def test_of_one_actuator_that_is_seen_both_explanations_are_given(turned, said):
    sideways = np.zeros((CELLS, CELLS, 2))
    sideways[1:3, :, 0] = 5.0
    for nu in (1, 2):  # of two, one of which is not seen, likewise
        a, b = np.array([sideways] * nu), np.array([turned(sideways)] * nu)
        (found,) = crossed(a, b, (0,), NAMES)
        assert found.startswith("shoulder moves ") and said in found and "scale" in found


@pytest.mark.parametrize(("took", "said"), [(0.041, ""), (0.002, "must wait until"), (0.06, "acts longer")])
def test_how_long_a_step_took_is_told(took, said):
    told = told_pace(took, 0.04)
    assert f"took {took} s, where the source's is 0.04 s long" in told and said in told and (":" in told) == bool(said)


UNITS = """
<mujoco><worldbody><body><joint name="h" type="hinge"/><geom size="1"/>
  <body><joint name="s" type="slide"/><geom size="1"/>
  <body pos="0 0 3"><joint name="b" type="ball"/><geom size="1"/></body>
  </body></body></worldbody>
  <actuator>
    <motor joint="h"/><motor joint="s" gear="100"/><motor joint="s" gear="0"/><position joint="h" kp="20" kv="3"/>
    <position joint="s" kp="7" gear="2"/><velocity joint="h" kv="4"/><intvelocity joint="s" kp="4" actrange="-1 1"/>
    <motor joint="b"/><cylinder joint="s"/><general joint="h" biastype="affine" gainprm="2" biasprm="0 -1 0"/>
  </actuator></mujoco>"""


def test_units_of_commands_are_those_of_joints_and_actuators():
    expected = ["N·m", "× 100 N", "", "rad", "× 0.5 m", "rad/s", "m/s", "", "N", ""]
    assert action_units(mujoco.MjModel.from_xml_string(UNITS)) == expected


def recordings(folder, *lengths, shown=None):
    """Trajectory files of the cart-pole's target, an episode each of so many control steps."""
    rng, paths = np.random.default_rng(0), []
    for i, T in enumerate(lengths):
        pixels = rng.integers(0, 256, (T + 1, 24, 24, 3), np.uint8)
        if shown is not None:
            pixels[:] = shown[i]
        episode = Episode(np.zeros((T, 1), np.float32), {"pixels": pixels})
        write_trajectories(folder / f"{i}.h5", Trajectories((episode,), 0.04, ""))
        paths.append(str(folder / f"{i}.h5"))
    return paths


SIDE = {"azimuth": 90, "elevation": 0, "distance": 2.1, "lookat": [0, 0, 0.43]}
"""Where the cart-pole's camera stands."""


def checked(folder, target, capsys):
    """Exit code and what `idapt check` prints of a target of recordings, with stacks of three images."""
    path = folder / "recorded.yaml"
    said = {"task": "gymnasium:InvertedPendulum-v5", "image_size": 32, "frame_stack": 3, "target": target}
    said["task_options"] = {"camera": SIDE}
    said["schedule"] = {"grounding_steps": len(target.get("recordings", "?")) - 1}
    path.write_text(yaml.safe_dump(said))
    code = main(["check", "--config", str(path), "--out", str(folder / "seen.png")])
    return code, capsys.readouterr().out


def test_all_recordings_are_looked_at(tmp_path, capsys):
    assert checked(tmp_path, {"recordings": recordings(tmp_path, 20, 20)}, capsys)[0] == 0
    paths = recordings(tmp_path, 3, 2, 20, 20, shown=[*np.random.default_rng(1).integers(0, 256, (3, 24, 24, 3)), 0])
    code, said = checked(tmp_path, {"recordings": paths}, capsys)
    assert code == 1 and f"{paths[0]}: the images of 1 of 1 episodes never change" in said
    assert f"{paths[1]}: 1 of 1 episodes have fewer than 4 images, the shortest 3; an observation has 3" in said
    assert f"{paths[0]}: 1 of 1 episodes have fewer" not in said
    assert f"{paths[3]}: 21 of 21 images are nearly of one colour" in said and f"{paths[3]}: the images" not in said


def test_what_was_brought_by_hand_is_looked_at(tmp_path, capsys):
    target = {"by_hand": str(tmp_path / "inbox")}
    assert checked(tmp_path, target, capsys)[0] == 0, "nothing is there yet"
    for k in (0, 1):
        (tmp_path / f"inbox/step_0{k}").mkdir(parents=True)
        recordings(tmp_path / f"inbox/step_0{k}", 20, shown=None if k == 0 else [9])
    code, said = checked(tmp_path, target, capsys)
    assert code == 1 and said.count("of one colour") == 1 and "step_01: 21 of 21 images" in said


def test_actions_that_the_target_cannot_be_told_or_that_hardly_move_it_are_named():
    actions = ActionMap.from_config({"scale": [1.0, 0.01], "offset": [0.5, 0.0]}, -np.ones(2), np.ones(2), NAMES)
    beyond, little = beyond_bounds(actions, -np.ones(2), np.ones(2))
    assert beyond.startswith("shoulder is told -0.5 to 1.5, and the target takes -1 to 1: what is beyond")
    assert little.startswith("elbow is told -0.01 to 0.01, and") and "same units" in little
    assert beyond_bounds(actions, np.array([-0.5, -0.01]), np.array([1.5, 0.01])) == []


def test_a_config_whose_target_moves_the_other_way(tmp_path, monkeypatch, capsys):
    (tmp_path / "my_lab.py").write_text(LAB)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    def config(scale):
        path = written(tmp_path, env="my_lab:CartPole", actions={"scale": scale})
        said = yaml.safe_load(path.read_text()) | {"task": "gymnasium:InvertedPendulum-v5"}
        said["task_options"] = {"camera": SIDE}
        path.write_text(yaml.safe_dump(said))
        return path

    command = ["check", "--config", str(config(1)), "--out", str(tmp_path / "seen.png"), "--move-target"]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "slide" in said and "-3 to 3 × 100 N" in said and "control steps for this" in said
    assert "a control step of the target took " in said and "where the source's is 0.04 s long" in said
    assert (tmp_path / "seen.png").stat().st_size > 500 and not (tmp_path / "runs").exists()

    config(2)
    assert main(command[:-1]) == 0
    told = "- slide is told -6 to 6, and the target takes -3 to 3: what is beyond is clipped (see target.actions)"
    assert told in capsys.readouterr().out
    config(-1)
    assert main(command) == 1
    assert "slide moves the other way: see the sign of target.actions.scale" in capsys.readouterr().out
    assert main(command[:-1]) == 0, "a target that may not be moved is looked at, no more"
