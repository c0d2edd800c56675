"""Which parts of a robot leave the picture, against what is drawn of them."""

from __future__ import annotations

import logging
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from datamodules import Episode, Trajectories, write_trajectories
from idapt_pl.effects import WHOLE, Domain, View
from idapt_pl.envs.image_env import SHOWN
from idapt_pl.rendering.make import make_renderer
from idapt_pl.stages.framing import drawn_geoms, framing, seen_at, warn_if_outside, wide_enough

MODEL = """
<mujoco><worldbody>
  <light pos="0 -3 3"/><camera name="view" pos="0 -3 0" xyaxes="1 0 0 0 0 1" fovy="45"/>
  <geom name="wall" type="box" size="5 .1 5" pos="0 3 0" rgba="0 0 0 1"/>
  <body name="carriage"><joint name="slide" type="slide" axis="1 0 0"/><joint name="lift" type="slide" axis="0 0 1"/>
    <geom name="bar" type="capsule" size="0.02" fromto="-0.3 0 0 0.3 0 0" rgba="1 1 1 1"/>
    <geom name="hull" type="sphere" size="2" group="4"/></body>
</worldbody></mujoco>"""
DOMAIN = Domain("source", lambda: mujoco.MjSpec.from_string(MODEL))


def at(positions):
    """Simulations of the model at positions (n, 2)."""
    model, kept = DOMAIN.compile(), []
    for q in positions:
        data = mujoco.MjData(model)
        data.qpos[:] = q
        kept.append(np.empty(mujoco.mj_stateSize(model, SHOWN)))
        mujoco.mj_getState(model, data, kept[-1], SHOWN)
    return kept


def touches_the_edge(view, positions):
    """In which pictures something bright does, bool (n,)."""
    model = DOMAIN.compile(view)
    render, data, touching = make_renderer(model, 64), mujoco.MjData(model), []
    for q in positions:
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        bright = render(data).max(-1) > 60
        touching.append(bright[[0, -1]].any() or bright[:, [0, -1]].any())
    render.close()
    return np.array(touching)


@pytest.fixture
def positions():
    return np.random.default_rng(0).uniform(-0.55, 0.55, (80, 2))


@pytest.mark.parametrize("view", [WHOLE, View(0.6, 0.1), View(0.5, -0.2, 0.15)])
def test_what_is_said_to_reach_out_does_in_the_pictures(view, positions):
    drawn = touches_the_edge(view, positions)
    model = DOMAIN.compile()
    (points,) = np.array([seen_at(model, s, drawn_geoms(model)) for s in at(positions)]).swapaxes(0, 1)
    edges = view.share / 2 - np.abs(points - [view.right, view.up])
    out, plain = (edges < 0).any((1, 2)), (np.abs(edges) > 0.02).all((1, 2))  # the bar has a width, pixels have too
    partly = (edges > 0.02).all(2).any(1)  # something is left to be seen
    assert (plain & partly).sum() > 30 and (view == WHOLE or (out & plain & partly).sum() > 3)
    assert (drawn == out)[plain & partly].all()


def test_the_view_that_it_names_shows_all(positions):
    found = framing(DOMAIN.compile(), at(0.6 * positions), View(0.4, 0.1))
    assert set(found.outside) == {"bar"} and 0.05 < found.outside["bar"] < 0.95
    inside = ~touches_the_edge(found.view, 0.6 * positions)
    assert inside.mean() > 0.9  # at each of four sides one of these 80 may be cut
    assert touches_the_edge(replace(found.view, share=found.view.share - 0.08), 0.6 * positions).any(), (
        "and no more than that"
    )


def test_a_robot_in_the_picture_is_not_spoken_of(positions):
    found = framing(DOMAIN.compile(), at(0.3 * positions), WHOLE)
    assert found.outside == {} and found.view is None


def test_a_world_in_which_nothing_moves_is_not_spoken_of():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><camera name='view'/><geom size='1'/></worldbody></mujoco>"
    )
    assert framing(model, [np.empty(mujoco.mj_stateSize(model, SHOWN))], View(0.1)).outside == {}


def test_what_is_mostly_outside_is_meant_to_be(positions):
    assert framing(DOMAIN.compile(), at(0.3 * positions), View(0.1, 0.0)).outside == {}


def test_a_camera_that_stands_too_near_is_to_be_moved():
    assert wide_enough(np.array([[-0.7, 0.0], [0.6, 0.1]])) is None
    assert wide_enough(np.array([[-0.2, 0.0], [0.3, 0.1]])) == View(0.52, 0.05, 0.05)
    found = framing(DOMAIN.compile(), at([[x, 0] for x in np.linspace(-1.5, 1.5, 40)]), WHOLE)
    assert "move it back" in str(found) and "bar in" in str(found)


def test_a_recording_is_warned_of(tmp_path, positions, caplog):
    rows = np.array(at(0.6 * positions))
    shown = {"pixels": np.zeros((80, 8, 8, 3), np.uint8), "simulation": rows}
    worlds = SimpleNamespace(source_domain=DOMAIN, view=View(0.4, 0.1))
    for observations, told in ((shown, True), ({"pixels": shown["pixels"]}, False)):
        write_trajectories(
            tmp_path / "source.h5", Trajectories((Episode(np.zeros((79, 1), np.float32), observations),), 0.1, "")
        )
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            warn_if_outside(worlds, tmp_path / "source.h5")
        assert ("parts of the robot leave the picture: bar in" in caplog.text) == told


@pytest.mark.parametrize(("before", "warned"), [(None, True), (0.6, False), (0.01, True)])
def test_what_was_said_in_the_step_before_is_not_said_again(tmp_path, positions, caplog, before, warned):
    worlds = SimpleNamespace(source_domain=DOMAIN, view=View(0.4, 0.1))
    for name, scale in (("source", 0.6), ("earlier", before)):
        shown = {"pixels": np.zeros((80, 8, 8, 3), np.uint8), "simulation": np.array(at((scale or 0) * positions))}
        file = Trajectories((Episode(np.zeros((79, 1), np.float32), shown),), 0.1, "")
        if scale is not None:
            write_trajectories(tmp_path / f"{name}.h5", file)
    with caplog.at_level(logging.WARNING):
        warn_if_outside(worlds, tmp_path / "source.h5", tmp_path / "earlier.h5")
    assert ("parts of the robot leave the picture" in caplog.text) == warned
