"""`idapt import` with images: files, arrays, videos and messages become frames of one size beside the joints."""

import base64
import io
import json

import numpy as np
import pytest
from PIL import Image
from test_import import MAP, MCAP_MAP, MODEL, START, arrays, by_array, changed, load, messages, recorded, write_csv

from datamodules.recordings import RecordingError, parse_mapping, summary
from datamodules.recordings.frames import CHANNELS, raw_image, video_frames

ROWS = 21


def picture(k, height=48, width=64):
    """An image uint8 (48, 64, 3) that tells which it is: a bright square moves right, 2 pixels a frame."""
    image = np.full((height, width, 3), (20, 60, 120), np.uint8)
    image[20:28, 8 + 2 * k : 16 + 2 * k] = (250, 220, 30)
    return image


def png(image):
    out = io.BytesIO()
    Image.fromarray(image).save(out, "PNG")
    return out.getvalue()


def assert_frames(episode, rows=range(ROWS), size=32):
    """Squares of the images' middles, in order, as large as was asked for."""
    pixels = episode.observations["pixels"]
    assert pixels.shape == (len(rows), size, size, 3) and pixels.dtype == np.uint8
    for frame, k in zip(pixels, rows, strict=True):
        bright = np.argwhere(frame[..., 0] > 160)
        expected = (8 + 2 * k + 4 - 8) * size / 48  # the middle 48 of 64 columns
        if 8 + 2 * k > 8 and 16 + 2 * k < 56:
            assert abs(bright[:, 1].mean() + 0.5 - expected) < 1.0, k


IMAGES = {"column": "front", "size": 32}


def test_a_table_names_picture_files(tmp_path):
    for k in range(ROWS):
        (tmp_path / "frames").mkdir(exist_ok=True)
        (tmp_path / f"frames/{k:03d}.png").write_bytes(png(picture(k)))
    table = recorded() | {"front": [f"frames/{k:03d}.png" for k in range(ROWS)]}
    path = write_csv(tmp_path / "run.csv", table)
    (episode,) = load(path, changed(images=IMAGES)).trajectories
    assert_frames(episode)
    assert "pixels" not in load(path).trajectories.episodes[0].observations  # not asked for
    assert load(path, changed(images="front")).trajectories.episodes[0].observations["pixels"].shape[1:] == (
        128,
        128,
        3,
    )
    (tmp_path / "frames/007.png").write_bytes(b"no picture")
    with pytest.raises(RecordingError, match=r"frames/007\.png: not a readable picture"):
        load(path, changed(images=IMAGES))
    (tmp_path / "frames/003.png").unlink()
    with pytest.raises(RecordingError, match=r"frames/003\.png: not a readable picture: no such file"):
        load(path, changed(images=IMAGES))


def test_arrays_of_images(tmp_path):
    whole = np.stack([picture(k) for k in range(ROWS)])
    np.savez(tmp_path / "run.npz", front=whole, **arrays())
    assert_frames(load(tmp_path / "run.npz", by_array() | {"images": IMAGES}).trajectories.episodes[0])
    np.savez(tmp_path / "short.npz", front=whole[:9], **arrays())
    with pytest.raises(RecordingError, match="column 'front' has 9 rows, expected 21"):
        load(tmp_path / "short.npz", by_array() | {"images": IMAGES})
    np.savez(tmp_path / "floats.npz", front=whole / 255, **arrays())
    with pytest.raises(RecordingError, match=r"no column 'front', which the map names at images\.column"):
        load(tmp_path / "floats.npz", by_array() | {"images": IMAGES})


def write_video(path, frames):
    av = pytest.importorskip("av")
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=50)
        stream.height, stream.width, stream.pix_fmt, stream.bit_rate = 48, 64, "yuv420p", 4_000_000
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


@pytest.mark.parametrize("layout", ["v2", "v3", "pictures"])
def test_lerobot_dataset(layout, tmp_path):
    """Two episodes: a video each, one video of both, or pictures in the table."""
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    folder, a = tmp_path / "pick", arrays()
    feature = "observation.images.front"
    rows = {"observation.state": a["q"].tolist(), "action": a["u"].tolist(), "timestamp": a["t"]}
    (folder / "data/chunk-000").mkdir(parents=True)
    (folder / "meta/episodes").mkdir(parents=True)
    for i in range(2):
        table = rows | {"episode_index": [i] * ROWS}
        if layout == "pictures":
            table[feature] = [{"bytes": png(picture(k)), "path": f"{k}.png"} for k in range(ROWS)]
        parquet.write_table(pyarrow.table(table), folder / f"data/chunk-000/episode_{i:06}.parquet")
    frames = [picture(k) for k in range(ROWS)]
    if layout == "v2":
        for i in range(2):
            write_video(folder / f"videos/chunk-000/{feature}/episode_{i:06d}.mp4", frames)
    if layout == "v3":
        write_video(folder / f"videos/{feature}/chunk-000/file-000.mp4", frames + frames)
        key = f"videos/{feature}"
        of = {"episode_index": [0, 1], f"{key}/chunk_index": [0, 0], f"{key}/file_index": [0, 0],
              f"{key}/from_timestamp": [0.0, ROWS / 50]}  # fmt: skip
        parquet.write_table(pyarrow.table(of), folder / "meta/episodes/file-000.parquet")
    features = {feature: {"dtype": "image" if layout == "pictures" else "video"}}
    version = "v3.0" if layout == "v3" else "v2.1"
    about = {"fps": 50, "codebase_version": version, "chunks_size": 1000, "features": features}
    (folder / "meta/info.json").write_text(json.dumps(about))
    mapping = {
        "time": "timestamp",
        "joints": {n: {"position": f"observation.state[{i}]"} for i, n in enumerate(("slider", "hinge"))},
        "actuators": {"push": "action[0]", "hinge": "action[1]"},
        "images": {"column": feature, "size": 32},
    }
    episodes = load(folder, mapping).trajectories
    assert len(episodes) == 2
    for episode in episodes:
        assert_frames(episode)
    if layout == "v3":
        del about["codebase_version"]
        (folder / "meta/info.json").write_text(json.dumps(about))
        with pytest.raises(RecordingError, match=r"meta does not say where the videos of observation\.images\.front"):
            load(folder, mapping)


def test_videos_that_are_short_missing_or_none(tmp_path):
    write_video(tmp_path / "a.mp4", [picture(k) for k in range(5)])
    assert video_frames(tmp_path / "a.mp4", 2, 3, 32).shape == (3, 32, 32, 3)
    with pytest.raises(RecordingError, match="has 5 frames, expected at least 6"):
        video_frames(tmp_path / "a.mp4", 2, 4, 32)
    with pytest.raises(RecordingError, match="no such file"):
        video_frames(tmp_path / "b.mp4", 0, 1, 32)
    (tmp_path / "c.mp4").write_bytes(b"no video at all" * 100)
    with pytest.raises(RecordingError, match="not a readable video"):
        video_frames(tmp_path / "c.mp4", 0, 1, 32)


@pytest.mark.parametrize("raw", [True, False])
def test_mcap_images_are_the_latest_before_each_row(raw, tmp_path):
    pytest.importorskip("mcap")
    from mcap.writer import Writer

    def image(k):
        if not raw:
            return {"format": "png", "data": base64.b64encode(png(picture(k))).decode()}
        data = base64.b64encode(picture(k)[..., ::-1].tobytes()).decode()
        return {"height": 48, "width": 64, "step": 192, "encoding": "bgr8", "data": data}

    path = tmp_path / "run.mcap"
    with path.open("wb") as f:
        writer = Writer(f)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {t: writer.register_channel(t, "json", schema) for t in ("/joint_states", "/command", "/camera")}
        taken = [(t, ns, c) for t, ns, c in messages()]
        taken += [("/camera", START + round(0.02 * k * 1e9) - 1_000_000, image(k)) for k in range(ROWS)]
        for topic, ns, content in sorted(taken, key=lambda m: m[1]):
            writer.add_message(channels[topic], ns, json.dumps(content).encode(), ns)
        writer.finish()
    (episode,) = load(path, MCAP_MAP | {"images": {"column": "/camera", "size": 32}}).trajectories
    assert_frames(episode)
    with pytest.raises(RecordingError, match="no topic '/cam'; did you mean '/camera'"):
        load(path, MCAP_MAP | {"images": "/cam"})
    with pytest.raises(RecordingError, match=r"not a readable picture|expected an image's bytes"):
        load(path, MCAP_MAP | {"images": "/command"})


@pytest.mark.parametrize("encoding", CHANNELS)
def test_raw_images_of_every_encoding_with_padded_rows(encoding):
    channels = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1}[encoding]
    rows = np.zeros((4, 5 * channels + 2), np.uint8)
    rows[:, : 5 * channels] = np.tile(np.arange(1, channels + 1), (4, 5))
    image = raw_image(rows.tobytes(), 4, 5, rows.shape[1], encoding, "here")
    assert image.shape == (4, 5, 3) and (image == np.array(CHANNELS[encoding]) + 1).all()
    with pytest.raises(RecordingError, match="here: an image of 5 x 4 has 3 bytes"):
        raw_image(b"abc", 4, 5, rows.shape[1], encoding, "here")
    with pytest.raises(RecordingError, match="encoded as 'yuv422'"):
        raw_image(rows.tobytes(), 4, 5, rows.shape[1], "yuv422", "here")


@pytest.mark.parametrize(("entry", "says"), [
    ({"size": 32}, r"images\.column: expected the name of a column"), ({"column": "a", "size": 4}, "16 to 1024 pixels"),
    ({"column": "a", "siez": 4}, "unknown key 'siez'"), ([1], "expected a name"),
])  # fmt: skip
def test_mistakes_in_the_map_are_named(entry, says, tmp_path):
    with pytest.raises(RecordingError, match=says):
        load(write_csv(tmp_path / "run.csv", recorded()), MAP | {"images": entry})


def test_images_and_actions_without_joints(tmp_path):
    model = tmp_path / "nominal.xml"
    model.write_text(MODEL)
    np.savez(tmp_path / "run.npz", front=np.stack([picture(k) for k in range(ROWS)]), **arrays())
    mapping = {"time": "t", "images": IMAGES, "actuators": {"push": "u[0]", "hinge": "u[1]"}}
    imported = load(tmp_path / "run.npz", mapping)
    (episode,) = imported.trajectories
    assert_frames(episode)
    assert set(episode.observations) == {"pixels"} and episode.actions.shape == (ROWS - 1, 2)
    assert "no qpos, no qvel, pixels 32 x 32, actions 2" in "".join(summary(imported, parse_mapping(mapping))[1])
    turned = mapping | {"actuators": {"hinge": "u[1]", "push": "u[0]"}}
    (ordered,) = load(tmp_path / "run.npz", turned, model=model).trajectories
    np.testing.assert_array_equal(ordered.actions, episode.actions)
    with pytest.raises(RecordingError, match=r"actuators: hinge of .* is not mapped"):
        load(tmp_path / "run.npz", mapping | {"actuators": {"push": "u[0]"}}, model=model)
    with pytest.raises(RecordingError, match="at least one joint with a position column, or images"):
        load(tmp_path / "run.npz", {"time": "t", "actuators": {"push": "u[0]"}})
