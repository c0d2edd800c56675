"""The LightningModules learn, on tiny fixed data, in seconds."""

import copy
from pathlib import Path

import lightning as L
import numpy as np
import pytest
import torch
from torch import nn
from torch.utils.data import DataLoader

from datamodules import Episode, OnPolicyDataModule, ReplayBuffer, ReplayDataModule
from idapt_pl.envs import GroundedEnv
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, StatePredictor, VisualTransformation, manual
from idapt_pl.modules.image_pool import ImagePool
from idapt_pl.nets.encoder import Vision
from idapt_pl.nets.images import to_float
from idapt_pl.rl.grounded_rollout import garat_rollout

SIZE = 32
SMALL = {"image_size": SIZE, "frame_stack": 2, "vision": Vision(strides=(2, 2, 1, 1)), "bf16": False}


def mean(history, name, rows):
    return float(np.mean([h[name] for h in history[rows]]))


def dots(n, color, background, seed=0, highest=0):
    """Stacks of two frames with a square in them, and where: uint8 (n, 2, 32, 32, 3), float32 (n, 2)."""
    rng = np.random.default_rng(seed)
    pixels = np.empty((n, 2, SIZE, SIZE, 3), np.uint8)
    pixels[:] = background
    corners = rng.integers((highest, 0), SIZE - 8, (n, 2))
    for image, (top, left) in zip(pixels, corners, strict=True):
        image[:, top : top + 8, left : left + 8] = color
    return torch.from_numpy(pixels), torch.from_numpy(corners.astype(np.float32))


class Fixed(L.LightningDataModule):
    """The same batch, over and over; ``data.labels`` and whatever else a module asks its data for."""

    def __init__(self, batch, **extra):
        super().__init__()
        self.batch = batch
        self.__dict__.update(extra)

    def train_dataloader(self):
        return DataLoader([self.batch] * 1000, batch_size=None)


class Labels:
    def __init__(self, labels):
        self.labels = labels.numpy()


# --- precision ------------------------------------------------------------------------------------------


def test_bfloat16_that_a_device_does_not_compute_in_changes_no_bit(monkeypatch):
    """On CPUs without, asking for it would be ten times as slow."""
    settings = SMALL | {"state_dim": 2, "width": 4, "blocks": 1, "discriminator_width": 4}
    torch.manual_seed(0)
    asking, plain = (VisualTransformation(**settings | {"bf16": asked}).eval() for asked in (True, False))
    plain.load_state_dict(asking.state_dict())
    pixels = np.random.default_rng(0).integers(0, 256, (2, 1, SIZE, SIZE, 3), np.uint8)
    with torch.no_grad():  # untrained, it is nearly grey whatever it is shown
        asking.G.body[-1].weight *= 50
        plain.G.body[-1].weight *= 50
    expected = plain.translate(pixels)
    monkeypatch.setattr(manual, "computes_bfloat16", lambda device: False)
    assert np.array_equal(asking.translate(pixels), expected)
    monkeypatch.setattr(manual, "computes_bfloat16", lambda device: True)
    assert np.array_equal(plain.translate(pixels), expected), "and none where it is not asked for"
    off = np.abs(asking.translate(pixels).astype(int) - expected)
    assert off.max() > 0 and off.mean() < 0.1 * expected.std(), "other digits of the same image"


def cpu_flags():
    """What Linux says that an x86 processor can do; None elsewhere."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    return next((set(line.split(":")[1].split()) for line in lines if line.startswith("flags")), None)


@pytest.mark.skipif(cpu_flags() is None, reason="no x86 processor, or not on Linux")
def test_processors_that_convolve_bfloat16_quickly_are_known():
    """Those with AVX-512 for bytes and words, which oneDNN's kernels of bfloat16 are written in."""
    assert manual.computes_bfloat16("cpu") == ({"avx512bw", "avx512vl", "avx512dq"} <= cpu_flags())
    assert not manual.computes_bfloat16("meta")


def test_a_build_without_onednn_computes_no_bfloat16_on_the_cpu(monkeypatch):
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: False)
    assert manual.computes_bfloat16("cpu") is False


# --- P^S ------------------------------------------------------------------------------------------------


@pytest.fixture
def fitted_P_S(trainer):
    """P^S fitted to where a red square is, its data and the losses."""
    pixels, state = dots(32, (255, 0, 0), (0, 0, 0))
    module, fit = StatePredictor(2, **SMALL, lr=1e-3), trainer(60)
    fit.fit(module, datamodule=Fixed({"pixels": pixels, "state": state}, data=Labels(state)))
    return module.eval(), pixels, state, fit.history


def test_state_predictor_loss_halves_on_a_fixed_batch(fitted_P_S):
    *_, history = fitted_P_S
    assert mean(history, "state_predictor/l1", slice(-3, None)) < 0.5 * mean(history, "state_predictor/l1", slice(0, 1))


def test_state_predictor_predicts_in_the_states_own_units(fitted_P_S):
    module, pixels, state, _ = fitted_P_S
    with torch.no_grad():
        error = (module.P_S.predict(pixels) - state).abs().mean()
    guess = (state - state.mean(0)).abs().mean()
    assert error < 0.5 * guess and guess > 3


# --- G --------------------------------------------------------------------------------------------------


def visual(**overrides):
    settings = {
        "state_dim": 2,
        "width": 4,
        "blocks": 1,
        "discriminator_width": 4,
        "pool_size": 4,
    }
    return VisualTransformation(**SMALL, **{**settings, "lr_generator": 2e-3, **overrides})


def paired_looks(pixels, state):
    return {
        "source": {"pixels": pixels[:8], "state": state[:8]},
        "target": {"pixels": dots(8, (0, 0, 255), (90, 90, 90), 1)[0]},
    }


@pytest.mark.parametrize("translate", ["frame", "stack"])
def test_visual_losses_fall_on_a_fixed_batch(trainer, fitted_P_S, translate):
    P_S, pixels, state, _ = fitted_P_S
    module, fit = visual(translate=translate), trainer(60)
    module.adopt(P_S.P_S)
    fit.fit(module, datamodule=Fixed(paired_looks(pixels, state)))
    history = fit.history
    for name in ("visual/cycle", "visual/identity"):
        assert mean(history, name, slice(-5, None)) < 0.6 * mean(history, name, slice(0, 3)), name
    total = [sum(h[f"visual/{k}"] for k in ("g_target", "g_source", "cycle", "identity", "state")) for h in history]
    assert np.mean(total[-5:]) < 0.7 * np.mean(total[:3])


def test_state_reconstruction_keeps_the_state_readable_after_translation(trainer, fitted_P_S):
    P_S, pixels, state, _ = fitted_P_S
    module, fit = visual(state_weight=20.0, cycle_weight=0.0, identity_weight=0.0), trainer(60)
    module.adopt(P_S.P_S)
    fit.fit(module, datamodule=Fixed(paired_looks(pixels, state)))
    assert mean(fit.history, "visual/state", slice(-5, None)) < 0.6 * mean(fit.history, "visual/state", slice(0, 3))


def at_reset(color, background, row):
    """Stacks with a square in the middle of a row, as after every reset: {"pixels": uint8 (2, 2, 32, 32, 3)}."""
    pixels = torch.empty(2, 2, SIZE, SIZE, 3, dtype=torch.uint8)
    pixels[:] = torch.tensor(background)
    pixels[:, :, row : row + 8, 12:20] = torch.tensor(color)
    return {"pixels": pixels}


@pytest.mark.parametrize("weight", [0.0, 10.0])
def test_only_reset_pairs_tell_G_where_to_place_things_in_domains_that_move_differently(trainer, weight):
    """The target's squares are all low, the source's everywhere; both start in row 12."""
    source, _ = dots(8, (255, 0, 0), (0, 0, 0))
    low, _ = dots(8, (0, 0, 255), (90, 90, 90), 1, highest=16)
    module, fit = visual(state_dim=0, reset_weight=weight, identity_weight=0.0), trainer(80)
    S, T = at_reset((255, 0, 0), (0, 0, 0), 12), at_reset((0, 0, 255), (90, 90, 90), 12)
    batch = {"source": {"pixels": source}, "target": {"pixels": low}, "source_resets": S, "target_resets": T}
    fit.fit(module, datamodule=Fixed(batch))
    off = np.abs(module.translate(S["pixels"][:1, -1:].numpy()).astype(float) - T["pixels"][:1, -1:].numpy()).mean()
    assert off < 12 if weight else off > 12
    assert ("visual/reset" in fit.history[-1]) == bool(weight)


def test_only_the_first_convolutions_of_P_T_are_trained(trainer, fitted_P_S):
    P_S, pixels, state, _ = fitted_P_S
    module = visual(finetune_convs=1)
    module.adopt(P_S.P_S)
    trainer(3).fit(module, datamodule=Fixed(paired_looks(pixels, state)))
    before = P_S.P_S.state_dict()
    moved = {k for k, v in module.P_T.state_dict().items() if not torch.equal(v, before[k])}
    assert moved == {"encoder.convs.0.weight", "encoder.convs.0.bias"}


def test_cycle_of_identity_nets_returns_the_input_and_costs_nothing():
    module = visual(state_dim=0)
    module.G = module.G_back = nn.Identity()
    pixels = dots(4, (200, 30, 70), (10, 20, 30))[0]
    np.testing.assert_array_equal(module.translate(pixels[:, :1].numpy()), pixels[:, :1])
    S, T = to_float(pixels[:2, -1]), to_float(pixels[2:, -1])
    fake_T, there = module.way_there(S, T, {"pixels": pixels[:2]}, (None, None))
    fake_S, back = module.way_back(S, T, (None, None))
    assert torch.equal(fake_T, S) and torch.equal(fake_S, T)
    for parts in (there, back):
        assert parts["cycle"] == 0 and parts["identity"] == 0 and "state" not in parts


def test_state_loss_by_hand_uses_the_whole_translated_stack(fitted_P_S):
    P_S, pixels, state, _ = fitted_P_S
    module = visual(state_weight=3.0)
    module.adopt(P_S.P_S)
    module.G = nn.Identity()
    S = to_float(pixels[:, -1])
    parts = module.way_there(S, S, {"pixels": pixels, "state": state}, (None, None))[1]
    expected = 3.0 * (P_S.P_S.encode(pixels) - P_S.P_S.standardise(state)).abs().mean()
    torch.testing.assert_close(parts["state"], expected)


def test_image_size_that_the_generator_cannot_keep_is_refused():
    with pytest.raises(ValueError, match=r"divisible by 4.*got 30"):
        VisualTransformation(2, image_size=30)


def test_contrastive_loss_alone_trains_one_side(trainer):
    module, fit = visual(state_dim=0, cycle_weight=0.0, identity_weight=0.0, contrastive_weight=1.0), trainer(60)
    assert module.G_back is None and module.D_S is None
    pixels, _ = dots(16, (255, 0, 0), (0, 0, 0))
    fit.fit(module, datamodule=Fixed(paired_looks(pixels, torch.zeros(16, 0))))
    assert set(fit.history[0]) == {"visual/g_target", "visual/contrastive", "visual/d_target", "step"}
    assert mean(fit.history, "visual/contrastive", slice(-5, None)) < 0.7 * mean(
        fit.history, "visual/contrastive", slice(0, 3)
    )
    with pytest.raises(ValueError, match="one-sided"):
        module.translate_stacks(pixels, back=True)


def test_consistency_looks_at_all_frames_and_costs_nothing_where_g_changes_nothing(fitted_P_S):
    module = visual(state_dim=0, consistency_weight=2.0)
    pixels = dots(4, (200, 30, 70), (10, 20, 30))[0]
    pixels[:, 1] = dots(4, (200, 30, 70), (10, 20, 30), 5)[0][:, 1]  # squares that jump
    S = to_float(pixels[:, -1])
    noisy = module.way_there(S, S, {"pixels": pixels}, (None, None))[1]["consistency"]
    assert noisy > 0
    still = pixels[:, :1].expand(-1, 2, -1, -1, -1)
    assert module.way_there(to_float(still[:, -1]), S, {"pixels": still}, (None, None))[1]["consistency"] == 0
    with pytest.raises(ValueError, match="frame_stack is 1"):
        VisualTransformation(0, 32, frame_stack=1, consistency_weight=1.0)


def test_averaged_g_follows_g_and_is_the_one_that_translates(trainer, fitted_P_S):
    P_S, pixels, state, _ = fitted_P_S
    module = visual(ema_decay=0.999)
    module.adopt(P_S.P_S)
    first = copy.deepcopy(module.G.state_dict())
    trainer(5).fit(module, datamodule=Fixed(paired_looks(pixels, state)))
    name = "body.0.1.weight"
    moved = (module.G.state_dict()[name] - first[name]).norm()
    behind = (module.G.state_dict()[name] - module.translator.state_dict()[name]).norm()
    assert 0 < behind < moved
    assert not np.array_equal(
        module.translate(pixels[:, :1].numpy()), visual_with(module.G).translate(pixels[:, :1].numpy())
    )


def test_with_a_background_g_starts_as_the_mean_image_of_the_other_domain(trainer):
    module, fit = visual(state_dim=0, background=True, lr_generator=0.0, ema_decay=0.9), trainer(1)
    (source, state), (target, _) = dots(8, (255, 0, 0), (0, 0, 0)), dots(8, (0, 0, 255), (90, 90, 90), 1)
    looks = {"source": {"pixels": source, "state": state}, "target": {"pixels": target}}
    fit.fit(module, datamodule=Fixed(looks))
    for made, other in ((module.translate_stacks(source), target), (module.translate_stacks(target, True), source)):
        mean_image = other.float().mean((0, 1))
        assert (made.float() - mean_image).abs().max() <= 0.005 * 255 + 1, "but for what tanh cannot give"
    assert source.float().mean((0, 1)).std() > 5


def test_a_fit_that_goes_on_keeps_the_background_it_learned(trainer):
    module = visual(state_dim=0, background=True)
    looks = paired_looks(*dots(8, (255, 0, 0), (0, 0, 0)))
    trainer(3).fit(module, datamodule=Fixed(looks))
    learned = copy.deepcopy(module.G.state_dict())
    trainer(0).fit(module, datamodule=Fixed(looks))
    module.on_fit_start()
    assert all(torch.equal(v, learned[k]) for k, v in module.G.state_dict().items())
    assert module.G.body[-1].weight.any()


def test_a_background_is_of_one_size():
    with pytest.raises(ValueError, match="32 x 32 pixels, and the images have 40 x 32"):
        visual(background=True).translate(np.zeros((1, 1, 40, 32, 3), np.uint8))


def visual_with(G):
    module = visual(state_dim=0)
    module.G = G
    return module


def test_options_that_are_off_leave_the_checkpoint_as_it_was():
    parts = {k.split(".")[0] for k in visual().state_dict()}
    assert parts == {"G", "G_back", "D_T", "D_S", "P_T"}


def test_a_stages_checkpoint_is_enough_to_make_the_module_again(tmp_path):
    rates = {"rates": {1: 0}, "dt": 0.04}
    settings = {**SMALL, "vision": Vision(strides=(2, 2, 1, 1), pool="keypoints", rates="differences")}
    module = VisualTransformation(2, **settings, **rates, width=4, blocks=1, discriminator_width=4)
    state = {"state_dict": module.state_dict(), "hyper_parameters": dict(module.hparams)}
    torch.save(state, tmp_path / "final.ckpt")
    again = VisualTransformation.from_checkpoint(tmp_path / "final.ckpt")
    assert again.P_T.rates == {1: 0} and again.P_T.dt == 0.04
    assert all(torch.equal(v, again.state_dict()[k]) for k, v in module.state_dict().items())


def test_whole_stacks_are_translated_frame_by_frame_as_single_frames_are():
    module = visual(state_dim=0)
    pixels = dots(3, (200, 30, 70), (10, 20, 30))[0]
    whole = module.translate_stacks(pixels).detach()
    frames = module.translate(pixels.flatten(0, 1)[:, None].numpy())
    assert np.abs(whole.flatten(0, 1).numpy().astype(int) - frames[:, 0]).max() <= 1


@pytest.mark.parametrize("translate", ["frame", "stack"])
def test_an_episode_is_translated_with_what_g_sees_of_its_own_frames(translate):
    """The newest frame of each stack, the first one repeated at the beginning; nothing else of the episode changes."""
    module = visual(state_dim=0, translate=translate)
    pixels, state = (x.numpy() for x in dots(4, (200, 30, 70), (10, 20, 30)))
    episode = Episode(np.ones((3, 1), np.float32), {"pixels": pixels[:, -1], "state": state})
    shown = module.translate_episode(episode)
    lags = np.arange(1 - module.frames, 1)
    stacks = pixels[np.maximum(np.arange(4)[:, None] + lags, 0), -1]
    np.testing.assert_array_equal(shown.observations["pixels"], module.translate(stacks)[:, -1])
    assert shown.observations["state"] is state and shown.actions is episode.actions


def test_image_pool_returns_past_images_about_half_of_the_time():
    pool = ImagePool(10)
    first = pool(torch.zeros(10, 1, 2, 2))
    assert (first == 0).all()
    old = torch.cat([pool(torch.full((1, 1, 2, 2), float(i))) for i in range(1, 201)])[:, 0, 0, 0]
    from_the_past = (old != torch.arange(1.0, 201)).float().mean()
    assert 0.35 < from_the_past < 0.65
    assert torch.equal(ImagePool(0)(old), old)


# --- F --------------------------------------------------------------------------------------------------


class Plain(nn.Module):
    """Features that are the observation itself."""

    features = 1

    def encode(self, pixels):
        return pixels.float()


class Line:
    """A point on a line, n times: x' = x + a. Episodes of 10 steps from a random start."""

    def __init__(self, n):
        self.n, self.rng = n, np.random.default_rng(0)

    def reset(self, seed):
        self.rng, self.t = np.random.default_rng(seed), 0
        self.x = self.rng.uniform(-1, 1, (self.n, 1)).astype(np.float32)
        return {"pixels": self.x.copy()}, {}

    def step(self, actions):
        self.x, self.t = self.x + actions, self.t + 1
        done, infos = np.full(self.n, self.t == 10), {}
        if done.any():
            infos = {"final_obs": {"pixels": self.x.copy()}}
            self.reset(int(self.rng.integers(2**31)))
        return {"pixels": self.x.copy()}, np.zeros(self.n), np.zeros(self.n, bool), done, infos


class LineData(OnPolicyDataModule):
    """Rollouts in the line, beside target transitions made directly: x' = x + effect * a + drift."""

    def __init__(self, F, rollouts, effect=1.0, drift=0.0):
        generator = torch.Generator().manual_seed(1)

        class Random:
            def on_features(self, features, only=None):
                return 2 * torch.rand(len(features), 1, generator=generator) - 1

            def played(self, actions):
                pass

            def tick(self, ended):
                pass

        roll = garat_rollout(Line(16), Random(), F, 16, seed=0)
        x, a = torch.rand(2000, 1) * 4 - 2, torch.rand(2000, 1) * 2 - 1
        target = {"features": x, "actions": a, "next_features": x + effect * a + drift}
        F.standardise(target)
        super().__init__(roll, target, rollouts)


def action_transformation(**overrides):
    settings = {
        "hidden": (32, 32),
        "lr": 3e-3,
        "lr_discriminator": 3e-3,
        "clip": 0.2,
        "batch_size": 64,
        "smoothing": 1.0,
    }
    return ActionTransformation(Plain(), [-1.0], [1.0], **{**settings, **overrides})


def test_new_action_transformation_is_nearly_the_identity():
    F = action_transformation()
    pixels, actions = (
        np.random.randn(50, 1).astype(np.float32),
        np.random.uniform(-1, 1, (50, 1)).astype(np.float32),
    )
    np.testing.assert_allclose(F.transform(pixels, actions), actions, atol=0.02)


def test_transformed_actions_stay_within_bounds_in_physical_units():
    F = ActionTransformation(Plain(), [-3.0, 0.0], [3.0, 10.0], hidden=(8,), smoothing=1.0, residual_scale=2.0)
    actions = torch.tensor([[0.0, 5.0], [3.0, 10.0], [-3.0, 0.0]])
    for delta in (-5.0, 5.0):
        transformed = F.apply_residual(actions, torch.full((3, 2), delta))
        assert torch.equal(transformed, (F.low if delta < 0 else F.high).expand(3, 2))
    torch.testing.assert_close(F.apply_residual(actions, torch.full((3, 2), 0.1))[0], torch.tensor([0.6, 6.0]))
    torch.testing.assert_close(F.normalise(torch.tensor([[0.0, 10.0]])), torch.tensor([[0.0, 1.0]]))


def test_without_smoothing_weight_the_action_is_left_alone():
    F, actions = action_transformation(smoothing=0.0), torch.rand(9, 1)
    assert torch.equal(F.apply_residual(actions, torch.randn(9, 1)), actions)


def test_discriminator_separates_two_different_transition_sets(trainer):
    F = action_transformation(lr=0.0, discriminator_batches=30)
    data, fit = LineData(F, rollouts=10, drift=2.0), trainer(10)
    fit.fit(F, datamodule=data)
    agent = {k: v.flatten(0, 1) for k, v in data.collect().items()}
    with torch.no_grad():
        agent_logits, target_logits = (
            F.D(F.transition_input(agent)),
            F.D(F.transition_input(data.target_transitions)),
        )
    accuracy = 0.5 * ((agent_logits > 0).float().mean() + (target_logits < 0).float().mean())
    assert accuracy > 0.9
    assert fit.history[-1]["dynamics/d_loss"] < fit.history[0]["dynamics/d_loss"]


def test_garat_learns_that_actions_do_half_as_much_in_the_target(trainer):
    F = action_transformation()
    actions = np.linspace(-1, 1, 41, dtype=np.float32)[:, None]
    x = np.random.uniform(-1, 1, actions.shape).astype(np.float32)
    before = np.abs(F.transform(x, actions) - 0.5 * actions).mean()
    trainer(40).fit(F, datamodule=LineData(F, rollouts=40, effect=0.5))
    after = np.abs(F.transform(x, actions) - 0.5 * actions).mean()
    assert after < 0.5 * before


def of_states(spread, middle=0.0):
    f = middle + spread * torch.randn(500, 1)
    return {"features": f, "next_features": f + 0.1 * spread * torch.randn(500, 1), "actions": torch.rand(500, 1)}


def test_an_F_that_goes_on_is_the_function_that_it_was_on_data_of_another_spread():
    F, new = action_transformation(), action_transformation()
    assert F.is_new
    F.standardise(of_states(1.0))
    for layer in (F.actor[-1], F.affine):
        nn.init.normal_(layer.weight)
    seen = of_states(0.5)
    x, told = F.agent_input(seen["features"], seen["actions"]), F.transition_input(seen)
    before = F.residual(x).mean, F.value(x), F.D(told)
    F.standardise(of_states(0.1, middle=3.0))
    x, told = F.agent_input(seen["features"], seen["actions"]), F.transition_input(seen)
    for was, now in zip(before, (F.residual(x).mean, F.value(x), F.D(told)), strict=True):
        torch.testing.assert_close(now, was, rtol=1e-3, atol=1e-4)
    assert F.feature_mean.item() == pytest.approx(3.0, abs=0.05), "and has the new scale"
    weights = new.actor[0].weight.clone()
    new.standardise(of_states(0.1))
    assert torch.equal(new.actor[0].weight, weights), "a new one has nothing to keep"


class Scaled(nn.Module):
    """Features with a weight of their own."""

    features = 1

    def __init__(self):
        super().__init__()
        self.weight = nn.Parameter(torch.ones(()))

    def encode(self, pixels):
        return pixels.float() * self.weight


def test_training_action_transformation_leaves_its_features_frozen(trainer):
    F = ActionTransformation(Scaled(), [-1.0], [1.0], hidden=(8,))
    before = [p.clone() for p in F.actor.parameters()]
    fit = trainer(2)
    fit.fit(F, datamodule=LineData(F, rollouts=2))
    assert F.encoder.weight == 1 and not F.encoder.weight.requires_grad
    assert any(not torch.equal(a, b) for a, b in zip(before, F.actor.parameters(), strict=True))
    optimized = {id(p) for o in fit.optimizers for g in o.param_groups for p in g["params"]}
    assert optimized == {id(p) for n, p in F.named_parameters() if not n.startswith("encoder.")}


# --- π --------------------------------------------------------------------------------------------------


def sac(encoder="learned", **overrides):
    settings = {"hidden": (32,), "lr": 1e-3, "gamma": 0.9}
    return AsymmetricSAC(2, [-3.0], [3.0], **SMALL, encoder=encoder, **{**settings, **overrides})


class FixedExperience:
    """The same 16 transitions at every step: the state is where the square is, the reward follows from it."""

    recent_return = 0.0

    def __init__(self, policy):
        pixels, state = dots(16, (255, 0, 0), (0, 0, 0))
        seen, state = policy.remember(pixels.numpy()), state.numpy() / SIZE
        self.transitions = {
            **seen, "state": state, "actions": np.linspace(-3, 3, 16, dtype=np.float32)[:, None],
            "rewards": state[:, 0] + 1, "terminations": np.arange(16) % 4 == 0,
            "next_observation": seen["observation"], "next_state": state,
        }  # fmt: skip

    def __call__(self):
        return self.transitions


@pytest.mark.parametrize("encoder", ["learned", "supervised"])
def test_sac_critic_loss_falls_on_fixed_data(trainer, encoder):
    module, fit = sac(encoder), trainer(40)
    images = 1 if encoder == "supervised" else 0
    data = ReplayDataModule(FixedExperience(module), ReplayBuffer(16, 0), 16, 4, 40, images, 16)
    fit.fit(module, datamodule=data)
    assert mean(fit.history, "policy/critic_loss", slice(-5, None)) < 0.5 * mean(
        fit.history, "policy/critic_loss", slice(0, 1)
    )
    if images:
        assert mean(fit.history, "policy/state_error", slice(-5, None)) < 0.7 * mean(
            fit.history, "policy/state_error", slice(0, 1)
        )


def test_sac_actor_moves_to_what_the_critics_prefer(trainer):
    """The reward is the action: after a while the mean action is large."""
    module, fit = sac(learn_temperature=False, temperature=1e-3, lr=3e-3), trainer(60)
    experience = FixedExperience(module)
    t = experience.transitions
    t["rewards"], t["terminations"] = t["actions"][:, 0].copy(), np.ones(16, bool)
    fit.fit(module, datamodule=ReplayDataModule(experience, ReplayBuffer(16, 0), 16, 4, 60))
    assert module.act(t["observation"], deterministic=True).mean() > 1.5


def test_sac_target_critics_follow_slowly(trainer):
    module = sac(tau=0.1)
    before = [p.clone() for p in module.critic_target.parameters()]
    for p in module.critic.parameters():
        p.data += 1.0
    module.track_critic()
    for old, new in zip(before, module.critic_target.parameters(), strict=True):
        torch.testing.assert_close(new, old + 0.1)


def test_sac_acts_within_bounds_deterministically_if_asked_and_at_random_if_not():
    module = sac()
    pixels = dots(16, (255, 0, 0), (0, 0, 0))[0].numpy()
    sampled = [module.act(pixels) for _ in range(2)]
    assert (np.abs(sampled) <= 3).all() and (sampled[0] != sampled[1]).any()
    np.testing.assert_array_equal(*(module.act(pixels, deterministic=True) for _ in range(2)))
    assert sampled[0].shape == (16, 1) and sampled[0].dtype == np.float32


def test_sac_temperature_rises_while_the_policy_is_too_certain(trainer):
    module, fit = sac(target_entropy=5.0, temperature=0.1), trainer(10)
    fit.fit(module, datamodule=ReplayDataModule(FixedExperience(module), ReplayBuffer(16, 0), 16, 4, 10))
    assert module.log_alpha.exp() > 0.1


def test_familiar_states_cost_nothing_and_unfamiliar_ones_up_to_the_whole_cost():
    """Two states equally far from the mean: one along the data's spread, one across it."""
    module = sac(unfamiliarity_cost=0.5, action_cost=0.2)
    along = torch.linspace(-1, 1, 101)
    module.set_familiar_states(torch.stack([along, along + 1e-2 * torch.sin(50 * along)], -1))
    batch = {
        "rewards": torch.ones(3),
        "actions": torch.tensor([[0.0], [0.0], [3.0]]),
        "next_state": torch.tensor([[0.0, 0.0], [0.1, -0.1], [0.1, 0.1]]),
    }
    at_mean, across, along_and_effort = module.shaped_rewards(batch).tolist()
    assert at_mean == pytest.approx(1.0, abs=1e-4)
    assert across == pytest.approx(0.5, abs=1e-3)
    assert along_and_effort == pytest.approx(0.8 - 0.5 * (1 - np.exp(-0.5 * 0.1**2 / along.var().item())), abs=5e-3)


def test_supervised_encoder_starts_as_the_state_predictor(fitted_P_S):
    P_S, pixels, *_ = fitted_P_S
    module = sac("supervised")
    module.start_from(P_S.P_S)
    torch.testing.assert_close(module.encode(pixels.numpy()), P_S.P_S.encode(pixels))


def test_grounded_environment_accepts_the_modules_as_they_are(cart):
    from idapt_pl.envs import VectorImageEnv

    G, F = visual(), ActionTransformation(StatePredictor(2, **SMALL).P_S, [-100.0], [100.0], hidden=(8,))
    env = GroundedEnv(VectorImageEnv(cart, cart.domain("source"), 2, SIZE, 2), G.translate, F.transform, G.frames)
    obs, _ = env.reset(seed=0)
    obs, *_ = env.step(np.zeros((2, 1), np.float32))
    assert obs["pixels"].shape == (2, 2, SIZE, SIZE, 3) and obs["pixels"].dtype == np.uint8
    assert (obs["pixels"] != obs["source_pixels"]).any()
    env.close()


# --- learning rates -------------------------------------------------------------------------------------


def rates_after(fit):
    """Learning rate of each optimizer, as a share of what it began with."""
    return [o.param_groups[0]["lr"] / o.param_groups[0]["initial_lr"] for o in fit.optimizers]


@pytest.mark.parametrize(("batches_done", "share"), [(4, 1.0), (6, 0.8), (9, 0.2), (10, 0.0)])
def test_visual_learning_rates_fall_to_zero_in_the_second_half_of_a_stage(trainer, fitted_P_S, batches_done, share):
    P_S, pixels, state, _ = fitted_P_S
    module, fit = visual(), trainer(10)
    module.adopt(P_S.P_S)
    module.on_train_batch_end = lambda outputs, batch, index: setattr(fit, "should_stop", index + 1 == batches_done)
    fit.fit_loop.min_epochs = 0
    fit.fit(module, datamodule=Fixed(paired_looks(pixels, state)))
    assert rates_after(fit) == pytest.approx([share, share], abs=1e-6)


def test_garat_learning_rate_falls_to_zero_and_the_discriminators_does_not(trainer):
    F, fit = action_transformation(), trainer(4)
    fit.fit(F, datamodule=LineData(F, rollouts=4))
    agent, discriminator = (o.param_groups[0]["lr"] for o in fit.optimizers)
    assert (agent, discriminator) == pytest.approx((0.0, 3e-3), abs=1e-8)


@pytest.mark.parametrize("floor", [0.25, 1.0])
def test_sac_learning_rates_fall_to_their_floor(trainer, floor):
    module, fit = sac(lr_floor=floor), trainer(8)
    fit.fit(module, datamodule=ReplayDataModule(FixedExperience(module), ReplayBuffer(16, 0), 16, 1, 8, 0, 16))
    assert rates_after(fit) == pytest.approx([floor] * 2)
