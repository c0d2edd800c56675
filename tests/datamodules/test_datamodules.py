"""Data modules: nothing reaches across episodes, batches are what they say, acting and learning alternate."""

import numpy as np
import pytest
import torch

from datamodules import (
    LabelledImages,
    OnPolicyDataModule,
    ReplayBuffer,
    ReplayDataModule,
    TrajectoryFileError,
    UnpairedImages,
    write_trajectories,
)
from datamodules.on_policy import encode_transitions, target_transitions
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.modules.manual import ManualModule

LENGTHS = [1, 4, 2, 7]


@pytest.fixture
def file(tmp_path, numbered):
    """Writes a file of numbered episodes and returns its path."""

    def write(name, lengths=LENGTHS, **kwargs):
        write_trajectories(tmp_path / name, numbered(lengths, **kwargs))
        return tmp_path / name

    return write


# --- stacks and transitions -----------------------------------------------------------------------------


@pytest.mark.parametrize("K", [1, 3, 5])
def test_frame_stacks_never_reach_across_episodes_and_repeat_the_first_frame(numbered, K):
    data = FrameStacks(numbered(LENGTHS), K, "state")
    every = np.arange(len(data))
    stacks = data.stacks(every)[:, :, 0, 0]  # (n, K, 3): episode, time, 0
    assert len(data) == sum(T + 1 for T in LENGTHS)
    for stack, (episode, t) in zip(stacks, data.labels, strict=True):
        assert (stack[:, 0] == episode).all()
        assert stack[:, 1].tolist() == [max(0, t + lag) for lag in range(1 - K, 1)]


def test_a_batch_is_the_same_as_its_items(numbered):
    data = FrameStacks(numbered(LENGTHS), 3, "state")
    batch = data.__getitems__([2, 9])
    for row, index in enumerate([2, 9]):
        assert all(torch.equal(batch[name][row], data[index][name]) for name in ("pixels", "state"))
    assert batch["pixels"].dtype == torch.uint8 and batch["state"].dtype == torch.float32


def test_target_stacks_carry_no_state(numbered):
    assert set(FrameStacks(numbered(LENGTHS, state=False), 3).__getitems__([0])) == {"pixels"}


@pytest.mark.parametrize("chunk", [3, 256])
def test_transitions_never_pair_across_an_episode_end(numbered, chunk):
    def encode(stacks):  # (episode, time) of the newest frame
        return torch.from_numpy(stacks[:, -1, 0, 0, :2].astype(np.float32))

    t = encode_transitions(FrameStacks(numbered(LENGTHS), 2), encode, chunk)
    assert len(t["features"]) == len(t["actions"]) == len(t["next_features"]) == sum(LENGTHS)
    torch.testing.assert_close(t["features"], t["actions"])  # actions hold (episode, time) too
    torch.testing.assert_close(t["next_features"], t["actions"] + torch.tensor([0.0, 1.0]))


# --- files to batches -----------------------------------------------------------------------------------


def test_labelled_images_gives_so_many_batches_of_matching_images_and_states(file):
    data = LabelledImages([file("a.h5"), file("b.h5", [3], first=5)], frame_stack=2, batch_size=4, batches=6, seed=0)
    data.setup("fit")
    batches = list(data.train_dataloader())
    assert len(batches) == 6
    for batch in batches:
        assert batch["pixels"].shape == (4, 2, 8, 8, 3)
        np.testing.assert_array_equal(batch["pixels"][:, -1, 0, 0, :2], batch["state"])
    assert {int(s) for b in batches for s in b["state"][:, 0]} > {5}, "both files are drawn from"


def drawn(data):
    data.setup("fit")
    return [{d: b[d]["pixels"] for d in b} for b, *_ in data.train_dataloader()]


def test_unpaired_images_draws_each_domain_on_its_own_and_the_target_without_states(file):
    source, target = file("s.h5"), file("t.h5", state=False)
    data = UnpairedImages([source], [target], frame_stack=1, batch_size=8, batches=5, seed=0)
    data.setup("fit")
    batches = [batch for batch, *_ in data.train_dataloader()]
    assert len(batches) == 5
    assert all(set(b["source"]) == {"pixels", "state"} and set(b["target"]) == {"pixels"} for b in batches)
    paired = np.mean(
        [(b["source"]["pixels"] == b["target"]["pixels"]).all(-1).all(-1).all(-1).float() for b in batches]
    )
    assert paired < 0.5, "source and target of the same time must not meet systematically"


def test_resets_are_first_observations_of_either_domain(file):
    data = UnpairedImages([file("s.h5")], [file("t.h5", first=9, state=False)], 2, 4, batches=6, seed=0, resets=3)
    data.setup("fit")
    batches = [batch for batch, *_ in data.train_dataloader()]
    assert len(batches) == 6
    for name, episodes in (("source_resets", {1, 2, 3, 4}), ("target_resets", {9, 10, 11, 12})):
        shown = torch.cat([b[name]["pixels"] for b in batches])[:, :, 0, 0]  # (n, K, 3): episode, time, 0
        assert len(shown) == 18 and (shown[..., 1] == 0).all(), "a first observation is its first frame, repeated"
        assert set(shown[..., 0].flatten().tolist()) == episodes


def test_what_is_played_again_is_drawn_together_with_what_the_target_showed(file):
    """Episode and time are written in the images; the source's episodes have other numbers and end sooner or later."""
    source, target = file("s.h5"), file("t.h5", first=9, state=False)
    replayed = file("r.h5", lengths=[2, 9, 1, 3])
    data = UnpairedImages([source], [target], 1, 4, batches=30, seed=0, resets=3, replayed=replayed)
    data.setup("fit")
    batches = [batch for batch, *_ in data.train_dataloader()]
    here, there = (torch.cat([b[f"{d}_resets"]["pixels"] for b in batches])[:, 0, 0, 0] for d in ("source", "target"))
    assert torch.equal(there[:, 0] - here[:, 0], torch.full((90,), 8)), "one episode"
    assert torch.equal(here[:, 1], there[:, 1]), "one time"
    shown = {tuple(x) for x in here[:, :2].tolist()}
    steps = {e: max(t for of, t in shown if of == e) for e in (1, 2, 3, 4)}
    assert steps == {1: 1, 2: 4, 3: 1, 4: 3}, "what both have"


def test_batches_are_reproducible_by_seed(file):
    files = [file("s.h5")], [file("t.h5", state=False)]
    a, b, c = (drawn(UnpairedImages(*files, frame_stack=1, batch_size=4, batches=4, seed=s)) for s in (1, 1, 2))
    same = [all(torch.equal(x[d], y[d]) for x, y in zip(a, other, strict=True) for d in x) for other in (b, c)]
    assert same == [True, False]


def test_source_and_target_of_different_size_is_an_error_that_names_files_and_sizes(file):
    data = UnpairedImages([file("s.h5")], [file("t.h5", state=False, size=12)], 1, 4, 1, 0)
    with pytest.raises(TrajectoryFileError, match=r"8x8 \(.*s\.h5\).*12x12 \(.*t\.h5\).*--image-size"):
        data.setup("fit")


def test_files_of_different_size_are_an_error_that_names_them(file):
    with pytest.raises(TrajectoryFileError, match=r"s\.h5 has 8x8; .*t\.h5 has 12x12"):
        read_all([file("s.h5"), file("t.h5", size=12)])


def test_a_file_without_images_is_an_error_where_images_are_needed(tmp_path, numbered):
    trajectories = numbered([3])
    del trajectories.episodes[0].observations["pixels"]
    write_trajectories(tmp_path / "s.h5", trajectories)
    with pytest.raises(TrajectoryFileError, match=r"s\.h5: episode_0/observations/pixels is missing"):
        read_all([tmp_path / "s.h5"])


def test_labels_from_a_file_without_states_are_an_error_that_names_it(file):
    data = LabelledImages([file("t.h5", state=False)], 1, 4, 1, 0)
    with pytest.raises(TrajectoryFileError, match=r"t\.h5.*state"):
        data.setup("fit")


# --- replay ---------------------------------------------------------------------------------------------


def transitions(first, n=3):
    """n transitions numbered from ``first``; 0 would be memory never written."""
    number = np.arange(first, first + n)
    names = ("observation", "state", "actions", "rewards", "next_observation", "next_state")
    values = {name: (number if name == "rewards" else number[:, None]).astype(np.float32) for name in names}
    return {**values, "terminations": np.zeros(n, bool)}


def test_replay_samples_only_what_is_stored():
    buffer = ReplayBuffer(100, seed=0)
    buffer.add(transitions(1, 7))
    assert buffer.size == 7
    assert set(buffer.sample(500)["rewards"].tolist()) == set(range(1, 8))


def test_replay_wraps_and_keeps_the_newest():
    buffer = ReplayBuffer(10, seed=0)
    for first in range(1, 25, 3):
        buffer.add(transitions(first))  # the last addition wraps around the end
    assert buffer.size == 10
    assert set(buffer.sample(1000)["rewards"].tolist()) == set(range(15, 25))


def test_replay_keeps_the_parts_of_a_transition_together():
    buffer = ReplayBuffer(10, seed=0)
    for first in range(1, 25, 3):
        buffer.add(transitions(first))
    sample = buffer.sample(4, 5)
    assert sample["state"].shape == (4, 5, 1) and sample["rewards"].shape == (4, 5)
    for name in ("observation", "state", "actions", "next_observation", "next_state"):
        assert torch.equal(sample[name][..., 0], sample["rewards"])


def test_replay_sampling_is_reproducible_and_an_empty_buffer_says_what_to_do():
    a, b = ReplayBuffer(10, seed=4), ReplayBuffer(10, seed=4)
    with pytest.raises(ValueError, match="act in the environment"):
        a.sample(1)
    for buffer in (a, b):
        buffer.add(transitions(1, 10))
    assert torch.equal(a.sample(20)["rewards"], b.sample(20)["rewards"])


class Acting:
    """Counts its calls; every transition holds the count."""

    recent_return = 0.0

    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        return transitions(self.calls, 1)


class Witness(ManualModule):
    """Notes, at each batch, how often had been acted and what the batch held."""

    def __init__(self, look):
        super().__init__()
        self.look, self.notes = look, []

    def training_step(self, batch, index):
        self.notes.append(self.look(batch))

    def configure_optimizers(self):
        return None


def test_replay_is_not_fetched_ahead_the_data_used_are_current(trainer):
    act = Acting()
    data = ReplayDataModule(act, ReplayBuffer(1, seed=0), batch_size=2, updates_per_batch=3, batches=5)
    witness = Witness(lambda batch: (act.calls, batch["transitions"]["rewards"].unique().tolist()))
    trainer(5).fit(witness, datamodule=data)
    assert witness.notes == [(k, [k]) for k in range(1, 6)]


def test_replay_gives_images_only_where_asked_for():
    def act():
        return {**transitions(1, 1), "pixels": np.zeros((1, 2, 4, 4, 3), np.uint8)}

    act.recent_return = 0.0
    for image_batches in (0, 2):
        data = ReplayDataModule(act, ReplayBuffer(5, 0), 2, 1, 1, image_batches, image_batch_size=3)
        (batch,) = data.train_dataloader()
        assert ("images" in batch) == bool(image_batches)
        assert "pixels" not in batch["transitions"], "replayed transitions carry no images they do not use"
    assert batch["images"]["pixels"].shape == (2, 3, 2, 4, 4, 3)


def test_each_garat_rollout_is_collected_with_the_weights_of_its_batch(trainer, file):
    count = []

    def collect():
        count.append(len(count) + 1)
        return {"k": torch.tensor([count[-1]])}

    target = target_transitions([file("t.h5", state=False)], lambda stacks: torch.zeros(len(stacks), 1), frame_stack=2)
    data = OnPolicyDataModule(collect, target, rollouts=4)
    witness = Witness(lambda batch: (len(count), batch["agent"]["k"].item(), len(batch["target"]["actions"])))
    trainer(4).fit(witness, datamodule=data)
    assert witness.notes == [(k, k, sum(LENGTHS)) for k in range(1, 5)]
