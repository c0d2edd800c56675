"""What the first frames of episodes look like on average, in recordings and in the model.

Where an episode begins is known without any dynamics: the task draws it. One frame is not the model's, since the draw
is another, but their mean is, and the spread says how well it is known.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.appearance.parameters import BlurParameter, VisualParameter
from idapt_pl.appearance.scene import sky_pixels, sky_texture, with_sky
from idapt_pl.effects import WHOLE, Domain, View
from idapt_pl.effects.visual import CAMERA, blur_of, blurred, engine_of
from idapt_pl.rendering.classic import FrameRenderer
from idapt_pl.tasks import Task

ParameterValues = Mapping[VisualParameter, np.ndarray]
"""Visual parameters and their values, (d,) each; all others are as in the source."""

FEW_STARTS = 4
"""Starts that will do where only the change of a picture counts."""


@dataclass(frozen=True)
class MeanImage:
    """Mean of pictures.

    Attributes:
        mean: (H, W, 3), 0 to 1.
        variance: of the mean, from the pictures' spread, (H, W, 3).
    """

    mean: np.ndarray
    variance: np.ndarray

    @classmethod
    def of(cls, pictures: np.ndarray) -> MeanImage:
        """Of uint8 (n, H, W, 3), n at least 2."""
        scaled = pictures.astype(np.float32) / 255
        return cls(scaled.mean(0), scaled.var(0, ddof=1) / len(scaled))


class FirstFrames(AbstractContextManager):
    """Renders what episodes of a domain begin with, with visual parameters set as asked.

    Args:
        task: draws the starts.
        domain: its model.
        size: side of the pictures, pixels.
        draws: starts.
        seed: of the draws; the same for all values of the parameters.
        view: the part of the camera's image that is rendered.

    Raises:
        ValueError: if the domain is drawn by another engine than the classic one, whose scene cannot be edited.
    """

    def __init__(self, task: Task, domain: Domain, size: int, draws: int, seed: int, view: View = WHOLE) -> None:
        domain = with_sky(domain)
        self.nominal = domain.compile(view)
        if engine_of(self.nominal) != "classic":
            raise ValueError(
                f"visual effects are found for domains that the classic renderer draws, not {domain.name!r}"
            )
        self.model = copy.copy(self.nominal)
        self._render = FrameRenderer(self.model, size)
        self._uploaded = sky_pixels(self.model).copy()
        rng = np.random.default_rng(seed)
        self._starts = [mujoco.MjData(self.model) for _ in range(draws)]
        for data in self._starts:
            task.reset(self.model, data, rng)
            mujoco.mj_forward(self.model, data)
        self._camera = i = self.model.camera(CAMERA).id
        self._cameras = [(d.cam_xpos[i].copy(), d.cam_xmat[i].copy()) for d in self._starts]

    def __exit__(self, *exception: object) -> None:
        self._render.close()

    def __call__(self, settings: ParameterValues, draws: int | None = None) -> np.ndarray:
        """One picture for each start, or for the first ``draws`` of them: uint8 (n, H, W, 3), as rendered."""
        self._apply_to_model(settings)
        pictures = []
        for data, (position, axes) in list(zip(self._starts, self._cameras, strict=True))[:draws]:
            data.cam_xpos[self._camera], data.cam_xmat[self._camera] = position, axes
            for parameter, values in settings.items():
                parameter.apply_to_state(data, values)
            pictures.append(self._render(data))
        return np.stack(pictures)

    def mean(self, settings: ParameterValues, few: bool = False) -> np.ndarray:
        """The mean picture, float (H, W, 3), 0 to 1, of all starts, or of a few.

        Blurring it is the same as the mean of blurred ones.
        """
        picture = self(settings, FEW_STARTS if few else None).mean(0) / 255
        if not any(isinstance(parameter, BlurParameter) for parameter in settings):
            picture = blurred(picture, blur_of(self.nominal))
        for parameter, values in settings.items():
            picture = parameter.apply_to_picture(picture, values)
        return picture

    def _apply_to_model(self, settings: ParameterValues) -> None:
        for name in ("light_diffuse", "light_ambient", "geom_matid", "geom_rgba"):
            getattr(self.model, name)[:] = getattr(self.nominal, name)
        for name in ("diffuse", "ambient"):
            setattr(self.model.vis.headlight, name, getattr(self.nominal.vis.headlight, name))
        sky = sky_pixels(self.model)
        sky[:] = sky_pixels(self.nominal)
        for parameter, values in settings.items():
            parameter.apply_to_model(self.model, values)
        if not np.array_equal(sky, self._uploaded):
            self._render.upload(sky_texture(self.model))
            self._uploaded = sky.copy()
