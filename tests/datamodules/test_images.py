"""Images from folders, datasets and trajectory files: read right, at one size, and plain about what is wrong."""

import shlex

import h5py
import numpy as np
import pytest
import torch
import torchvision
from PIL import Image

from datamodules import write_trajectories
from datamodules.images import Augmentation, Fitted, ImageDomains, ImageError, Reading, from_folder, read_image
from datamodules.images.labels import read_labels


def picture(height=12, width=20, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)


def save(path, image, **options):
    path.parent.mkdir(parents=True, exist_ok=True)
    image = image if isinstance(image, Image.Image) else Image.fromarray(image)
    image.save(path, **options)
    return path


@pytest.fixture
def photos(tmp_path):
    """A folder as CycleGAN's datasets are laid out."""
    for name, n in (("trainA", 5), ("trainB", 4), ("testA", 2), ("testB", 2)):
        for i in range(n):
            save(tmp_path / name / f"{i}.png", picture(seed=i))
    return tmp_path


# --- files ----------------------------------------------------------------------------------------------


def test_a_plain_image_is_read_byte_for_byte(tmp_path):
    np.testing.assert_array_equal(read_image(save(tmp_path / "a.png", picture())), picture())


def test_grey_images_of_8_and_16_bits_become_the_same_three_channels(tmp_path):
    grey = picture()[..., 0]
    wide = grey.astype(np.uint16) * 257
    for path in (save(tmp_path / "8.png", grey), save(tmp_path / "16.png", wide)):
        np.testing.assert_array_equal(read_image(path), np.repeat(grey[..., None], 3, 2))


def test_what_is_transparent_becomes_white(tmp_path):
    image = np.full((4, 4, 4), 80, np.uint8)
    image[0, :, 3], image[1:, :, 3] = 0, 255
    read = read_image(save(tmp_path / "a.png", image))
    assert (read[0] == 255).all() and (read[1:] == 80).all()


def test_photographs_are_turned_upright(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera was held on its side
    assert read_image(save(tmp_path / "a.jpg", picture(12, 20), exif=exif)).shape == (20, 12, 3)


def broken(folder, kind):
    path = save(folder / f"{kind}.png", picture(64, 64))
    data = path.read_bytes()
    path.write_bytes({"empty": b"", "truncated": data[: len(data) // 2], "foreign": b"not an image"}[kind])
    return path


@pytest.mark.parametrize(
    ("kind", "says"), [("empty", "0 bytes"), ("truncated", "cannot be read"), ("foreign", "no im")]
)
def test_a_broken_image_is_named_with_what_is_wrong(tmp_path, kind, says):
    path = broken(tmp_path, kind)
    with pytest.raises(ImageError, match=rf"{path.name}.*{says}"):
        read_image(path)


@pytest.mark.parametrize("cache", [True, False])
def test_broken_images_are_an_error_or_left_out_and_counted_as_chosen(photos, caplog, cache):
    for kind in ("empty", "truncated"):
        broken(photos / "trainA", kind)
    with pytest.raises(
        ImageError, match=r"trainA: 2 of 7 images cannot be read.*empty\.png.*truncated\.png.*on_bad skip"
    ):
        from_folder(photos / "trainA", Reading(cache=cache))
    images = from_folder(photos / "trainA", Reading(on_bad="skip", cache=cache))
    assert images.names == [f"{i}.png" for i in range(5)] and "2 of 7" in caplog.text
    np.testing.assert_array_equal(images.stacks([4, 0])[:, 0], [picture(seed=4), picture(seed=0)])


def test_folders_without_images_or_that_are_missing_are_named(tmp_path):
    (tmp_path / "notes.txt").write_text("no image")
    with pytest.raises(ImageError, match="holds no images"):
        from_folder(tmp_path, Reading())
    with pytest.raises(ImageError, match="there: no such folder"):
        from_folder(tmp_path / "there", Reading())


def test_folders_in_folders_are_looked_through_and_hidden_files_are_not(tmp_path):
    for name in ("b/2.png", "a/1.JPG", ".trash/3.png", "._4.png"):
        save(tmp_path / name, picture())
    assert from_folder(tmp_path, Reading()).names == ["a/1.JPG", "b/2.png"]


# --- sizes ----------------------------------------------------------------------------------------------


def test_images_of_different_sizes_need_a_chosen_size(photos):
    save(photos / "trainA" / "large.png", picture(40, 19))
    with pytest.raises(ImageError, match=r"differ in size: 0\.png is 12x20 and large\.png 40x19.*--data\.size") as told:
        from_folder(photos / "trainA", Reading())
    assert shlex.split(str(told.value))[-2:] == ["--data.size", "[12,20]"]  # one word of a command, multiples of 4
    assert from_folder(photos / "trainA", Reading((16, 24))).frames.shape == (6, 16, 24, 3)


@pytest.mark.parametrize(("how", "size"), [("resize", (12, 20)), ("pad", (12, 24)), ("crop", (8, 20))])
def test_without_a_size_images_go_to_the_nearest_the_generator_takes(tmp_path, how, size):
    save(tmp_path / "a.png", picture(11, 21))
    assert from_folder(tmp_path, Reading(how=how)).frames.shape[1:3] == size


@pytest.mark.parametrize(("height", "width"), [(11, 21), (64, 30), (30, 64), (7, 7)])
@pytest.mark.parametrize("how", ["resize", "pad", "crop"])
def test_fitted_images_have_the_size_and_go_back_to_their_own(how, height, width):
    fit = Fitted(32, 40, how)
    fitted = fit(picture(height, width))
    assert fitted.shape == (32, 40, 3)
    assert fit.undo(fitted, height, width).shape == ((32, 40, 3) if how == "crop" else (height, width, 3))


def test_padding_loses_nothing():
    fit = Fitted(32, 40, "pad")
    np.testing.assert_array_equal(fit.undo(fit(picture(11, 21)), 11, 21), picture(11, 21))


# --- labels ---------------------------------------------------------------------------------------------

NAMES = ["a.png", "b/c.png"]


def labels_file(folder, suffix, names=NAMES, state=((1.0, 2.0), (3.0, 4.0))):
    path = folder / f"labels{suffix}"
    if suffix == ".csv":
        lines = ["x,file,y"] + [f"{x},{name},{y}" for name, (x, y) in zip(names, state, strict=True)]
        path.write_text("\n".join(lines))
    elif suffix == ".npz":
        np.savez(path, names=np.array(names), state=np.array(state))
    else:
        with h5py.File(path, "w") as f:
            f["names"], f["state"] = names, np.array(state)
    return path


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".h5"])
def test_labels_go_to_the_images_they_name_in_whatever_order(tmp_path, suffix):
    path = labels_file(tmp_path, suffix, NAMES[::-1])
    np.testing.assert_array_equal(read_labels(path, NAMES), np.float32([[3, 4], [1, 2]]))


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".h5"])
def test_images_without_a_label_are_named(tmp_path, suffix):
    with pytest.raises(ImageError, match=r"no label for 1 of 3 images: new\.png"):
        read_labels(labels_file(tmp_path, suffix), [*NAMES, "new.png"])


def test_labels_that_do_not_match_are_errors_that_say_how(tmp_path):
    np.savez(tmp_path / "rows.npz", state=np.zeros((3, 2)))
    np.savez(tmp_path / "none.npz", other=np.zeros((3, 2)))
    np.savez(tmp_path / "nan.npz", state=np.full((2, 2), np.nan))
    np.savez(tmp_path / "objects.npz", state=np.array([{}, {}], dtype=object))
    (tmp_path / "words.csv").write_text("file,x\na.png,1\nb/c.png,left")
    (tmp_path / "noname.csv").write_text("x,y\n1,2")
    (tmp_path / "bytes.npz").write_bytes(b"PK not a zip")
    for name, says in (
        ("rows.npz", "3 states for 2 images"),
        ("none.npz", "no array 'state'"),
        ("nan.npz", "finite"),
        ("objects.npz", "not a readable NPZ.*allow_pickle"),
        ("words.csv", "line 3.*number.*left"),
        ("noname.csv", "column 'file'"),
        ("bytes.npz", "not a readable NPZ"),
        ("labels.txt", "no such file"),
    ):
        with pytest.raises(ImageError, match=f"(?s){says}"):
            read_labels(tmp_path / name, NAMES)


# --- domains --------------------------------------------------------------------------------------------


def test_cyclegans_folders_are_found_and_give_the_dimensions(photos):
    data = ImageDomains(root=str(photos))
    assert data.dimensions == {"state_dim": 0, "image_size": [12, 20], "frame_stack": 1}
    assert data.has_tests and [len(data.load(d)) for d in ("source", "target")] == [5, 4]


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"root": "nowhere"}, "nowhere: no such folder.*trainA"),
        ({"source": "trainA"}, "data.target.*trainB.*is needed"),
        ({"source": "trainA", "target": "notes.txt"}, "neither a folder nor a trajectory file"),
        ({"source": "one", "target": "trainB"}, "the source has 1 image; .*at least 2"),
        ({"source": "trainA", "target": "trainB", "batch_size": 5}, "the target has 4 images; .*at least 5"),
        ({"source": "trainA", "target": "wide"}, "differ in size: .*12x20; .*12x24.*--data.size"),
        ({"source": "trainA", "target": "trainB", "size": (30, 30)}, r"data.size: .*multiples of 4, got \[30, 30\]"),
        ({"source": "trainA", "target": "trainB", "augment": Augmentation((16, 20))}, r"\[16, 20\] is larger.*12x20"),
        ({"source": "trainA", "target": "trainB", "frame_stack": 3}, "no other frames: use 1"),
        (
            {"source": "trainA", "target": "trainB", "labels": "labels.npz", "augment": Augmentation(flip=True)},
            "leave it out, or leave out labels",
        ),
        (
            {"source": "trainA", "target": "trainB", "test_source": "testA", "test_target": "wide", "paired": True},
            "2 source and 3 target test images",
        ),
    ],
)
def test_what_is_wrong_with_the_data_is_said_before_training(photos, monkeypatch, settings, says):
    monkeypatch.chdir(photos)
    save(photos / "one" / "0.png", picture())
    for i in range(3):
        save(photos / "wide" / f"{i}.png", picture(12, 24, i))
    np.savez(photos / "labels.npz", state=np.zeros((5, 2)))
    with pytest.raises(ImageError, match=says):
        ImageDomains(**settings).setup("fit")


def test_torchvision_datasets_are_places_too():
    data = ImageDomains(
        source=torchvision.datasets.FakeData(3, (3, 12, 20), transform=torchvision.transforms.ToTensor()),
        target=torchvision.datasets.FakeData(4, (3, 12, 20), random_offset=9),
    )
    assert data.dimensions["image_size"] == [12, 20]
    source = torchvision.datasets.FakeData(3, (3, 12, 20))
    np.testing.assert_array_equal(data.load("source").stacks([2])[0, 0], np.array(source[2][0]))


def test_trajectories_bring_stacks_and_the_sources_states_only(tmp_path, numbered):
    for name in ("s", "t"):
        write_trajectories(tmp_path / f"{name}.h5", numbered([3, 4], size=10))
    data = ImageDomains(source=str(tmp_path / "s.h5"), target=str(tmp_path / "t.h5"), frame_stack=3)
    assert data.dimensions == {"state_dim": 2, "image_size": [12, 12], "frame_stack": 3}
    batch = data.load("source").__getitems__([1, 5])
    assert batch["pixels"].shape == (2, 3, 12, 12, 3) and batch["state"].tolist() == [[1, 1], [2, 1]]
    assert "state" not in data.load("target").__getitems__([0]), "the target's states are not for training"


def test_augmentation_cuts_windows_and_mirrors_half_of_them_all_frames_of_a_stack_alike():
    pixels = torch.from_numpy(np.stack([np.stack([picture(seed=i)] * 2) for i in range(40)]))
    out = Augmentation((8, 12), flip=True)(pixels)
    assert out.shape == (40, 2, 8, 12, 3) and torch.equal(out[:, 0], out[:, 1])
    mirrored = 0
    for image, window in zip(pixels[:, 0], out[:, 0], strict=True):
        windows = image.unfold(0, 8, 1).unfold(1, 12, 1).permute(0, 1, 3, 4, 2)  # (5, 9, 8, 12, 3)
        straight = (windows == window).flatten(2).all(2).any()
        flipped = (windows == window.flip(1)).flatten(2).all(2).any()
        assert straight != flipped
        mirrored += int(flipped)
    assert 8 < mirrored < 32
