"""Measures and shows translations in validate, test and at the end of training epochs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio.v3 as iio
import lightning as L
import numpy as np
import torch
from lightning.pytorch.loggers import TensorBoardLogger
from torch import Tensor
from torchvision.utils import make_grid

from datamodules.images import ImageDomains, Reading, TrajectoryImages
from idapt_pl.evaluation.image_quality import (
    Backbone,
    FeatureProbe,
    PairedScores,
    StateError,
    fit_feature_probe,
    kernel_distance,
    newest,
)
from idapt_pl.evaluation.video import gif, gif_summary, side_by_side
from idapt_pl.files import write_atomically, write_json
from idapt_pl.modules import VisualTransformation
from idapt_pl.modules.state_predictor import fit_state_predictor
from idapt_pl.nets.encoder import Vision
from idapt_pl.nets.images import to_float


class TranslationQuality(L.Callback):
    """Figures of the translated test images, logged as ``quality/...`` and kept in ``quality.json``.

    ``kid`` is between translated and target images, ``kid_before`` between source and target, and ``kid_floor`` between
    the target's training and test images: what a perfect translation would have. With ``data.paired`` there are
    ``psnr`` and ``ssim``, and with states the ``state_error``s of P^T (and of a probe) on translated images.

    Args:
        probe_batches: gradient steps of the autoencoder whose features KID is measured on.
        backbone: file with the weights of torchvision's resnet18, to measure KID on its features instead.
        target_states: trajectory file of the target with states, to train a probe on. For evaluation only.
        state_batches: gradient steps of that probe.
        video_frames: length of the video of a trajectory.
    """

    def __init__(
        self,
        probe_batches: int = 300,
        backbone: str | None = None,
        target_states: str | None = None,
        state_batches: int = 2000,
        video_frames: int = 75,
    ) -> None:
        self.probe_batches, self.backbone, self.target_states = probe_batches, backbone, target_states
        self.state_batches, self.video_frames = state_batches, video_frames
        self.probe: Backbone | FeatureProbe | None = None
        self.state_probe: torch.nn.Module | None = None

    def on_validation_epoch_start(self, trainer: L.Trainer, pl_module: VisualTransformation) -> None:
        """Make what measures; probes are trained the first time."""
        device, data = pl_module.device, trainer.datamodule
        if self.probe is None:
            if self.backbone:
                self.probe = Backbone(Path(self.backbone)).to(device)
            else:
                known = [data.load("source"), data.load("target")]
                self.probe = fit_feature_probe(known, self.probe_batches, device)
        if self.target_states and self.state_probe is None:
            self.state_probe = self.fit_state_probe(self.target_states, data, device)
        self.features: dict[str, list[Tensor]] = {"source": [], "translated": [], "target": []}
        self.pairs = PairedScores().to(device) if data.paired else None
        predictors = {"state_error": pl_module.P_T, "state_error_probe": self.state_probe}
        self.states = {k: StateError(p).to(device) for k, p in predictors.items() if p is not None}
        if self.state_probe is not None and data.paired:
            self.states["state_error_probe_floor"] = StateError(self.state_probe).to(device)
        self.shown: list[np.ndarray] = []

    def fit_state_probe(self, states: str, data: ImageDomains, device: torch.device) -> torch.nn.Module:
        """P of the target, from the labelled target images of a trajectory file.

        Args:
            states: the file.
            data: whose images the probe is shown; its images have their size.
            device: where it is trained.

        Raises:
            ValueError: if the file has no states.
        """
        like = data.load("test_source")
        size = (like.fit.height, like.fit.width)
        labelled = TrajectoryImages([states], data.frame_stack, Reading(size, like.fit.how))
        if labelled.labels is None:
            raise ValueError(f"{states}: has no observations/state; the probe is trained on states")
        with torch.random.fork_rng(), torch.enable_grad(), torch.inference_mode(False):
            torch.manual_seed(0)
            vision = Vision(strides=(2, 2, 1, 1), pool="keypoints")
            probe = vision.predictor(size, data.frame_stack, labelled.labels.shape[1], {}, 1.0)
            return fit_state_predictor(probe, labelled, self.state_batches, 32, 1e-3, device).to(device)

    def on_validation_batch_end(
        self,
        trainer: L.Trainer,
        pl_module: VisualTransformation,
        outputs: dict[str, Tensor],
        batch: dict,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Add a batch."""
        source, target = batch.get("source"), batch.get("target")
        looks: dict[str, Any] = {"source": source and source["pixels"], "translated": outputs.get("source")}
        looks["target"] = target and target["pixels"]
        assert self.probe is not None  # made when the epoch began
        for name, pixels in looks.items():
            if pixels is not None:
                self.features[name].append(self.probe(to_float(pixels[:, -1])))
        if self.pairs is not None:
            self.pairs.update(*(looks[name][:, -1] for name in ("source", "translated", "target")))
        if source is None:
            return
        if "state" in source:
            for name, error in self.states.items():
                error.update(looks["target" if name.endswith("floor") else "translated"], source["state"])
        kept = [looks["source"], looks["translated"], *([looks["target"]] if self.pairs is not None else [])]
        self.shown.extend(np.stack([k[:, -1].cpu().numpy() for k in kept], axis=1))  # (3, H, W, 3) each

    def on_validation_epoch_end(self, trainer: L.Trainer, pl_module: VisualTransformation) -> None:
        """Log the figures, a grid and, of a trajectory, a video."""
        figures = self.distances(trainer, pl_module)
        if self.pairs is not None:
            figures |= self.pairs.compute()
        if trainer.datamodule.load("test_source").labels is not None:
            figures |= {name: error.compute() for name, error in self.states.items()}
        pl_module.log_dict({f"quality/{k}": v for k, v in figures.items() if v == v}, sync_dist=True)
        if trainer.is_global_zero:
            folder = Path(trainer.default_root_dir)
            write_json(folder / "quality.json", {k: round(v, 5) if v == v else None for k, v in figures.items()})
            self.show(trainer, folder, isinstance(trainer.datamodule.load("test_source"), TrajectoryImages))

    def distances(self, trainer: L.Trainer, pl_module: VisualTransformation) -> dict[str, float]:
        """KID of translated images, of source images, and between two sets of target images."""
        assert self.probe is not None  # made when the epoch began
        known = trainer.datamodule.load("target")
        some = torch.linspace(0, len(known) - 1, min(len(known), 500)).long().tolist()
        parts = [some[i : i + 32] for i in range(0, len(some), 32)]
        floor = torch.cat([self.probe(newest(known, part, pl_module.device)) for part in parts])
        source, translated, target = (
            pl_module.all_gather(torch.cat(self.features[name])).reshape(-1, floor.shape[1])
            for name in ("source", "translated", "target")
        )
        return {
            "kid": kernel_distance(target, translated),
            "kid_before": kernel_distance(target, source),
            "kid_floor": kernel_distance(target, floor),
        }

    def show(self, trainer: L.Trainer, folder: Path, moving: bool) -> None:
        """A picture with the rows source, translated and, of pairs, target; in TensorBoard and the run folder."""
        board = trainer.logger.experiment if isinstance(trainer.logger, TensorBoardLogger) else None
        step = trainer.current_epoch
        chosen = [self.shown[i] for i in np.linspace(0, len(self.shown) - 1, min(8, len(self.shown))).astype(int)]
        rows = torch.from_numpy(np.stack(chosen, axis=1)).flatten(0, 1).movedim(-1, 1)
        grid = make_grid(rows, nrow=len(chosen))
        png = iio.imwrite("<bytes>", grid.movedim(0, -1).numpy(), extension=".png")
        write_atomically(folder / "quality.png", lambda path: path.write_bytes(png))
        if board is not None:
            board.add_image("quality/source_translated_target", grid, step)
        if moving:
            data = gif(side_by_side(*np.stack(self.shown[: self.video_frames], axis=1)))
            write_atomically(folder / "quality.gif", lambda path: path.write_bytes(data))
            if board is not None:
                board._get_file_writer().add_summary(gif_summary("quality/video", data), step)

    on_test_epoch_start = on_validation_epoch_start
    on_test_batch_end = on_validation_batch_end
    on_test_epoch_end = on_validation_epoch_end
