"""Visual effects from first frames: parameters say what their effects say, planted ones are found, and nothing else."""

import base64
import json
from contextlib import closing

import mujoco
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from datamodules import Episode, Trajectories, write_trajectories
from idapt_pl.appearance.discovery import discover_visual_effects
from idapt_pl.appearance.first_frames import FirstFrames
from idapt_pl.appearance.fit import finite_differences
from idapt_pl.appearance.parameters import (
    BlurParameter,
    CameraParameter,
    ColorParameter,
    LightParameter,
    SkyParameter,
    visual_parameters,
)
from idapt_pl.appearance.result import VisualEffects
from idapt_pl.appearance.search import find_visual_effects
from idapt_pl.effects import Domain
from idapt_pl.effects.visual import Blur, Color, Light, Renderer
from idapt_pl.envs import VectorImageEnv
from idapt_pl.rendering.make import make_renderer
from idapt_pl.tasks import make_task

PENDULUM = make_task("inverted_pendulum")
CHANGED = {
    CameraParameter: [0.05, -0.04, 0.1, 0.03, -0.02, 0.05],
    LightParameter: [0.3, 0.5, 0.2, 0.4, 0.3, 0.1],
    ColorParameter: [0.9, 0.2, 0.1],
    SkyParameter: [0.2, 0.5, 0.7, 0.1, 0.05, 0.3],
    BlurParameter: [4.0],
}


def begins(task, effects, size=40, episodes=12):
    """First frames of episodes in the task's source with effects."""
    source = task.domain("source")
    target = Domain("target", source.base, (*source.effects, *effects))
    with closing(VectorImageEnv(task, target, episodes, size, 1)) as env:
        return env.reset(seed=3)[0]["pixels"][:, 0]


@pytest.mark.parametrize("kind", CHANGED)
@pytest.mark.parametrize("name", ["inverted_pendulum", "half_cheetah"])
def test_a_parameter_shows_what_its_effects_show(name, kind):
    task = make_task(name)
    source = task.domain("source")
    parameter, values = (
        next(p for p in visual_parameters(source.spec()) if isinstance(p, kind)),
        np.array(CHANGED[kind]),
    )
    repaired = source.with_effects(*parameter.effects(source.spec(), values))
    with FirstFrames(task, source, 64, 3, seed=0) as frames, FirstFrames(task, repaired, 64, 3, seed=0) as others:
        nominal, changed, said = frames.mean({}), frames.mean({parameter: values}), others.mean({})
    if (
        kind is BlurParameter
    ):  # the effect is on what the environments render, which FirstFrames leaves to its parameter
        data = mujoco.MjData(model := repaired.compile())
        task.reset(model, data, np.random.default_rng(0))
        mujoco.mj_forward(model, data)
        with closing(make_renderer(model, 64)) as soft, FirstFrames(task, source, 64, 1, seed=0) as one:
            changed, said = one.mean({parameter: values}), soft(data) / 255
    change = np.abs(changed - nominal).mean()
    assert change > 0.3 / 255, "the parameter does nothing, so this says nothing"
    assert np.abs(changed - said).mean() < 0.1 * change


def test_nominal_values_show_the_nominal_picture_again():
    source = make_task("half_cheetah").domain("source")
    settings = {p: np.array(CHANGED[type(p)]) for p in visual_parameters(source.spec())}
    with FirstFrames(make_task("half_cheetah"), source, 32, 2, seed=0) as frames:
        before, changed, after = frames({}), frames(settings), frames({})
    assert (before == after).all()
    assert (before != changed).any()


def test_blurred_images_are_those_of_the_renderer_under_a_gaussian():
    sharp, soft = begins(PENDULUM, (), episodes=1)[0], begins(PENDULUM, (Blur("world", 0.03),), episodes=1)[0]
    expected = gaussian_filter(sharp.astype(float), (0.03 * 40, 0.03 * 40, 0), mode="nearest")
    assert np.abs(soft - expected).max() <= 0.51


def test_a_source_that_is_blurred_already_is_shown_blurred():
    soft = PENDULUM.domain("source").with_effects(Blur("world", 0.02))
    blur = next(p for p in visual_parameters(soft.spec()) if isinstance(p, BlurParameter))
    assert blur.nominal == pytest.approx([4.0])
    with FirstFrames(PENDULUM, soft, 32, 2, seed=0) as frames:
        assert frames.mean({}) == pytest.approx(frames.mean({blur: blur.nominal}))
        assert np.abs(frames.mean({}) - frames.mean({blur: np.zeros(1)})).max() > 0.05


def test_nothing_is_found_where_nothing_is_planted():
    result = find_visual_effects(PENDULUM, PENDULUM.domain("source"), begins(PENDULUM, ()), seed=1)
    assert result.effects == result.estimates == ()
    assert result.before < 2 * result.floor


@pytest.mark.parametrize(
    ("effect", "key", "truth"),
    [
        (Color("cart", (0.2, 0.3, 0.8, 1)), ("color", "cart"), [0.2, 0.3, 0.8]),
        (
            Light("headlight", diffuse=(0.5, 0.4, 0.3), ambient=(0.15, 0.1, 0.05)),
            ("light", "headlight"),
            [0.5, 0.4, 0.3, 0.15, 0.1, 0.05],
        ),
        (Blur("world", 0.025), ("blur", "world"), [6.25]),
    ],
)
def test_a_planted_visual_effect_is_found_alone(effect, key, truth):
    result = find_visual_effects(PENDULUM, PENDULUM.domain("source"), begins(PENDULUM, (effect,)), seed=1, draws=4)
    (found,) = result.estimates
    assert found.key == key
    assert list(found.estimate.values()) == pytest.approx(truth, rel=0.15, abs=0.05)
    assert result.after < max(0.2 * result.before, 1.5 * result.floor) < result.before


def test_a_camera_that_was_bumped_is_found():
    source = PENDULUM.domain("source")
    camera = next(k for k in visual_parameters(source.spec()) if isinstance(k, CameraParameter))
    bump = np.array([0.04, -0.03, 0.06, 0.02, -0.015, 0.03])
    result = find_visual_effects(
        PENDULUM, source, begins(PENDULUM, camera.effects(source.spec(), bump), 48), seed=1, draws=6
    )
    (found,) = result.estimates
    assert found.key == camera.key
    moved = list(found.estimate.values())
    # Small shifts and turns look alike; what the picture shows is where things are in it, and how it is turned.
    assert moved[0] / 2.04 - moved[4] == pytest.approx(bump[0] / 2.04 - bump[4], abs=0.005)
    assert moved[5] == pytest.approx(bump[5], abs=0.005)
    assert result.after < 0.3 * result.before


def test_what_is_found_in_a_file_can_be_added_to_the_source(tmp_path):
    frames = begins(PENDULUM, (Color("cart", (0.2, 0.3, 0.8, 1)),))
    episodes = tuple(Episode(np.zeros((1, 1), np.float32), {"pixels": np.stack([f, f])}) for f in frames)
    write_trajectories(tmp_path / "d.h5", Trajectories(episodes, 0.04, "test"))
    source = PENDULUM.domain("source")
    found = discover_visual_effects(PENDULUM, source, tmp_path / "d.h5", seed=0)
    repaired = source.with_effects(*found.effects)
    assert repaired.compile().geom("cart").rgba[:3] == pytest.approx([0.2, 0.3, 0.8], abs=0.05)
    assert found.after < 0.2 * found.before
    assert found.estimates[0].std["red"] > 0
    assert VisualEffects.from_dict(json.loads(json.dumps(found.to_dict()))) == found, "the file says it all"
    assert base64.b64decode(found.picture).startswith(b"\x89PNG")


def test_too_few_episodes_are_refused():
    with pytest.raises(ValueError, match="at least 4 episodes, got 3"):
        find_visual_effects(PENDULUM, PENDULUM.domain("source"), begins(PENDULUM, (), episodes=3), seed=0)


def test_a_file_without_images_is_refused(tmp_path):
    episode = Episode(np.zeros((1, 1), np.float32), {"qpos": np.zeros((2, 2))})
    write_trajectories(tmp_path / "d.h5", Trajectories((episode,), 0.04, "test"))
    with pytest.raises(ValueError, match=r"d.h5: there is no episode_0/observations/pixels"):
        discover_visual_effects(PENDULUM, PENDULUM.domain("source"), tmp_path / "d.h5", seed=0)


def test_frames_that_are_not_square_are_refused():
    with pytest.raises(ValueError, match=r"square images .* got shape \(4, 8, 6, 3\)"):
        find_visual_effects(PENDULUM, PENDULUM.domain("source"), np.zeros((4, 8, 6, 3), np.uint8), seed=0)


def test_a_source_of_another_engine_is_refused():
    other = PENDULUM.domain("source").with_effects(Renderer("world", engine="filament"))
    with pytest.raises(ValueError, match="classic renderer"):
        FirstFrames(PENDULUM, other, 32, 2, seed=0)


def test_slopes_are_central_where_bounds_leave_room_and_one_sided_where_not():
    def square(x):
        return x**2

    half, low, high = np.full(3, 0.5), np.zeros(3), np.full(3, 2.0)
    central = np.array([True, False, True])
    slopes = finite_differences(square, np.array([1.0, 1.0, 2.0]), half, low, high, central)
    assert np.diag(slopes) == pytest.approx([2.0, 2.5, 3.5]), "2x, and (x + h)² - x² over h, and at the upper bound"
    assert finite_differences(square, low, half, low, high, central)[0, 0] == pytest.approx(0.5)
