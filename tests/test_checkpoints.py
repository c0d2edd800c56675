"""A checkpoint that is not as it was written is never loaded."""

import hashlib

import lightning as L
import numpy as np
import pytest
import torch

from idapt_pl.checkpoints import checkpoint_bytes, load_weights, read_checkpoint
from idapt_pl.files import DamagedFile, write_json


class Net(L.LightningModule):
    def __init__(self, width=40):
        super().__init__()
        self.save_hyperparameters()
        self.layer = torch.nn.Linear(width, width)


@pytest.fixture
def path(tmp_path):
    """A checkpoint and the note beside it, as a stage writes them."""
    weights = checkpoint_bytes(Net())
    (tmp_path / "final.ckpt").write_bytes(weights)
    note = {"step": 0, "stage": "toy", "wall_s": 1.0, "sha256": hashlib.sha256(weights).hexdigest()}
    write_json(tmp_path / "stage.json", note, checked=True)
    return tmp_path / "final.ckpt"


def test_what_is_written_is_read_and_the_same_weights_are_the_same_bytes(path):
    net = Net()
    load_weights(net, path)
    assert checkpoint_bytes(net) == path.read_bytes()
    assert read_checkpoint(path)["hyper_parameters"] == {"width": 40}


def test_64_changed_bytes_are_found_wherever_they_are(path):
    whole = path.read_bytes()
    for start in np.linspace(0, len(whole) - 64, 60).astype(int):
        damaged = bytes(b ^ 0x5A for b in whole[start : start + 64])
        path.write_bytes(whole[:start] + damaged + whole[start + 64 :])
        with pytest.raises(DamagedFile, match=r"final\.ckpt: .*checksum in stage\.json.*Delete it"):
            read_checkpoint(path)


def test_of_an_older_run_that_noted_no_checksum_no_weight_can_change_unseen(path):
    (path.parent / "stage.json").unlink()
    whole, before = path.read_bytes(), read_checkpoint(path)["state_dict"]
    for start in np.linspace(0, len(whole) - 64, 60).astype(int):
        path.write_bytes(whole[:start] + bytes(b ^ 0x5A for b in whole[start : start + 64]) + whole[start + 64 :])
        try:
            after = read_checkpoint(path)["state_dict"]
        except DamagedFile as error:
            assert str(error).startswith(f"{path}: cannot be used")
        else:  # padding
            assert all(torch.equal(after[k], v) for k, v in before.items())


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04", None])
def test_what_is_no_checkpoint_is_an_error_that_names_it(path, content):
    (path.parent / "stage.json").unlink()
    path.write_bytes(path.read_bytes()[:2000] if content is None else content)
    with pytest.raises(DamagedFile, match=r"final\.ckpt: cannot be used"):
        read_checkpoint(path)


def test_another_modules_checkpoint_is_an_error_that_names_it(path):
    with pytest.raises(DamagedFile, match=r"final\.ckpt: cannot be used \(Error.* in loading state_dict"):
        load_weights(Net(width=30), path)
    (path.parent / "stage.json").unlink()
    torch.save({"weights": 1}, path)
    with pytest.raises(DamagedFile, match=r"final\.ckpt: .*does not hold 'state_dict'"):
        load_weights(Net(), path)


def test_a_damaged_note_is_named_itself(path):
    note = path.parent / "stage.json"
    note.write_text(note.read_text().replace("toy", "top"))
    with pytest.raises(DamagedFile, match=rf"stage\.json: .*Delete the folder {path.parent}"):
        read_checkpoint(path)


def test_pickled_code_does_not_run(path):
    class Evil:
        def __reduce__(self):
            return (print, ("code ran",))

    (path.parent / "stage.json").unlink()
    torch.save({"state_dict": Evil()}, path)
    with pytest.raises(DamagedFile, match=r"final\.ckpt: cannot be used"):
        read_checkpoint(path)
