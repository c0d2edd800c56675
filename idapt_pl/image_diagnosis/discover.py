"""Which physical effect does the source lack? Found from the target's images and actions alone.

An estimator of the state, fitted to what G shows of the source, turns the target's images into positions and
velocities. Where it tells how fast things move, windows of what it read are replayed; where it does not, the source
with an effect must forecast what it reads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from idapt_pl.effects import Domain
from idapt_pl.envs import VectorImageEnv
from idapt_pl.image_diagnosis.calibration import read_calibrated
from idapt_pl.image_diagnosis.forecast_diagnosis import diagnose_by_forecasts
from idapt_pl.image_diagnosis.result import ImageDiagnosis
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.image_diagnosis.settings import DiscoverySettings
from idapt_pl.image_diagnosis.windows import diagnose_by_windows
from idapt_pl.modules import VisualTransformation


def discover_effects(
    source: Domain, sensor: ImageSensor, G: VisualTransformation, target: Sequence[Path],
    control: Sequence[Path], options: DiscoverySettings, seed: int, make_env: Callable[[Domain, int], VectorImageEnv],
    paired_steps: int = 0,
) -> ImageDiagnosis:  # fmt: skip
    """Find the effects that the target's images show the source to lack.

    Args:
        source: the domain to be repaired, with what has been found so far.
        sensor: reads target images; its task's states tell positions.
        G: shows source images as target images.
        target: trajectory files of the target; images and actions are all that is used.
        control: trajectory files of the source as it is now, with images and states; the sensor was not fitted to them.
        options: what to look for.
        seed: of the choice of windows, or of resets.
        make_env: simulations of a domain, so many side by side, with images as the sensor takes them.
        paired_steps: control steps from where episodes begin that G learned as pairs; forecasts are not judged there.

    Raises:
        ValueError: if forecasts are needed, and there are too few episodes for them or a candidate has several
            parameters.
    """
    readings = read_calibrated(sensor, source, target, control, G)
    if readings.calibration.velocities_unreliable:
        return diagnose_by_forecasts(
            source, sensor, G, target, control, options, seed, make_env, readings, paired_steps
        )
    return diagnose_by_windows(sensor.task, source, readings, options, seed)
