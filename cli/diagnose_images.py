"""`idapt diagnose --run`: recordings of images, read by the estimator of a run."""

from __future__ import annotations

import argparse
import base64
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from tqdm import tqdm
from tqdm.contrib.logging import logging_redirect_tqdm

from cli.arguments import show_bar
from datamodules.unpaired import read_all
from idapt_pl.appearance.discovery import discover_visual_effects
from idapt_pl.effects import Domain, Effect
from idapt_pl.effects.wording import format_number
from idapt_pl.envs import VectorImageEnv
from idapt_pl.files import write_atomically, write_yaml
from idapt_pl.image_diagnosis import ImageDiagnosis
from idapt_pl.image_diagnosis.calibration import CalibratedReadings, read_calibrated
from idapt_pl.image_diagnosis.forecast_diagnosis import diagnose_by_forecasts
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.image_diagnosis.settings import DEFAULT_CANDIDATES, DiscoverySettings
from idapt_pl.modules import VisualTransformation
from idapt_pl.report.forecast_files import write_forecast_diagnosis
from idapt_pl.run import Run


@dataclass(frozen=True)
class ImageRecordings:
    """Recordings of images as a run's sensor reads them.

    Attributes:
        sensor: the estimator of the run's last grounding step.
        G: shows it source images.
        control: recordings of the source; the sensor was not fitted to them, where the run has such.
        readings: of both.
    """

    sensor: ImageSensor
    G: VisualTransformation
    control: Path
    readings: CalibratedReadings

    def diagnose_arguments(self, source: Domain) -> dict[str, Any]:
        """What :func:`~idapt_pl.diagnosis.diagnose` must know of the sensor.

        Its errors on images of the source count as noise, although they depend on the state and are not white: see
        decision 17.
        """
        noise = self.readings.calibration.noise(source.compile(), self.sensor.task.unseen)
        return {"noise": noise, "unmeasured": self.readings.unmeasured}


def read_images(run: Run, data: Path) -> ImageRecordings:
    """Read recordings with the estimator of a run.

    Raises:
        ValueError: their images are of another size than those that the run's networks see.
    """
    worlds, folder = run.worlds, run.folder
    height, width = read_all([data]).episodes[0].observations["pixels"].shape[1:3]
    if (height, width) != (worlds.image_size, worlds.image_size):
        raise ValueError(
            f"{data}: its images are {height}x{width}, and {folder} reads {worlds.image_size}x{worlds.image_size}. "
            "Nothing is scaled or cut here: they have to show what the run's own target.h5 shows, in the same size"
        )
    sensor, G = ImageSensor(run.load_estimator(), worlds.task, worlds.frame_stack), run.load_visual()
    control = [*folder.glob("step_00/source.h5"), *sorted(folder.glob("step_*/control.h5"))][-1]
    return ImageRecordings(sensor, G, control, read_calibrated(sensor, worlds.source_domain, [data], [control], G))


def diagnose_images_by_forecasts(
    run: Run, images: ImageRecordings, o: argparse.Namespace, declared: Sequence[Effect]
) -> ImageDiagnosis:
    """Diagnose by forecasts, for a sensor that cannot tell how fast things move; write its files.

    Args:
        run: whose estimator reads the images.
        images: as read.
        o: arguments of ``idapt diagnose``.
        declared: effects known already.

    Raises:
        ValueError: if episodes were chosen, of which forecasts take the first.
    """
    if o.fit or o.hold_out:
        raise ValueError(
            f"{o.run}: its sensor cannot tell how fast things move, so effects are judged by forecasts of "
            f"{o.data[0]}'s first episodes, and by none that is held out: leave --fit and --hold-out away"
        )
    worlds, started = run.worlds, time.perf_counter()
    options = DiscoverySettings(True, tuple(o.candidates or DEFAULT_CANDIDATES), o.max_effects)
    source = worlds.source_domain.with_effects(*declared)
    layout = "{desc}: {n} hypotheses played and rendered {elapsed}"
    with tqdm(desc="forecasts", bar_format=layout, leave=False, disable=not show_bar()) as bar, logging_redirect_tqdm():

        def make_env(domain: Domain, num_envs: int) -> VectorImageEnv:
            bar.update()
            return worlds.image_env(domain, num_envs)

        result = diagnose_by_forecasts(
            source, images.sensor, images.G, o.data, [images.control], options, o.seed, make_env, images.readings,
            run.config.schedule.paired_steps,
        )  # fmt: skip
    names, seconds = (o.run.name, o.data[0].name), time.perf_counter() - started
    write_forecast_diagnosis(result, worlds.source_domain, declared, o.out, names, seconds)
    return result


def report_visual_effects(run: Run, data: Path, out: Path, seed: int) -> None:
    """Say which visual effects the source of a run lacks; write ``looks.yaml`` and ``looks.png``.

    Every episode must begin as the task's do.
    """
    worlds, console = run.worlds, Console()
    found = discover_visual_effects(worlds.task, worlds.source_domain, data, seed, worlds.view)
    out.mkdir(parents=True, exist_ok=True)
    effects = [e.to_dict() for e in found.effects]
    write_yaml(out / "looks.yaml", effects)
    write_atomically(out / "looks.png", lambda path: path.write_bytes(base64.b64decode(found.picture)))
    names = ", ".join(f"{e.effect} of {e.target}" for e in found.estimates) or "none was found"
    before, after, floor = map(format_number, (found.before, found.after, found.floor))
    for sentence in (
        f"visual effects that the source lacks: {names}.",
        f"The recording's first frames are {before} levels of 255 from the source's, {after} with these effects; noise "
        f"alone makes {floor}. {out / 'looks.png'} shows source, source with the effects, recording.",
    ):
        console.print(escape(sentence), soft_wrap=True, highlight=False)
