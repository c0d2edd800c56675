"""Effects that the target's images show the source to lack, found and added to it between the stages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from idapt_pl.appearance import discover_visual_effects
from idapt_pl.effects import effect_from_dict
from idapt_pl.files import read_json, write_yaml
from idapt_pl.image_diagnosis import DiscoverySettings, discover_effects
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.modules import AsymmetricSAC, VisualTransformation
from idapt_pl.randomisation import found_intervals
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.known_start_search import effects_from_known_starts
from idapt_pl.stages.replay_search import effects_from_replays


@dataclass(frozen=True)
class SourceRepair:
    """Looks for effects in the target's recordings, and adds what it finds to the run's source. Off by default.

    Attributes:
        context: of the run.
        settings: whether and what to look for.
        record_control: grounding step to a new recording of the source as it is, from exploration, with states.
        randomised: whether policies train in variants of the source from then on, within the intervals of what is
            found.
        paired_steps: control steps from where episodes begin that G learned as pairs, which hide what is missing.
    """

    context: StageContext
    settings: DiscoverySettings
    record_control: Callable[[int], Path]
    randomised: bool = False
    paired_steps: int = 0

    def visual_effects(self, D_T: Path) -> None:
        """Add the visual effects that the first frames of the target's episodes show the source to lack."""
        if not self.settings.looks:
            return
        worlds = self.context.worlds

        def make(seed: int) -> dict:
            return discover_visual_effects(worlds.task, worlds.source_domain, D_T, seed, worlds.view).to_dict()

        self._add(0, self.context.stages.measure(0, "looks", make)["effects"])

    def physical_effects(self, k: int, D_T: Sequence[Path], G: VisualTransformation, pi: AsymmetricSAC) -> bool:
        """Add the physical effects that the target's images show the source to lack. Returns whether there were any.

        Images are read by π's estimator. What it makes of new recordings of the source says how well.
        """
        if not self.settings.discover or (k and not self.settings.every_step):
            return False
        worlds = self.context.worlds
        target = list(D_T) if k == 0 else [D_T[0], D_T[-1]]
        control = self.record_control(k)
        if worlds.task.tells_positions:
            found, estimates = self._found_by_positions(k, target, control, G, pi)
        else:
            sought = (self.context, k, self.settings, target, control, G, pi, self.paired_steps)
            found, estimates = effects_from_replays(*sought), []
        if found and self.randomised:
            told = self.context.stages.folder(k) / "known_start_search.json"
            refined = read_json(told)["parameters"] if told.exists() else []
            worlds.distribution = worlds.distribution.then(found_intervals(found, estimates, refined))
        return self._add(k, found)

    def _found_by_positions(
        self, k: int, target: list[Path], control: Path, G: VisualTransformation, pi: AsymmetricSAC
    ) -> tuple[list[dict], list[dict]]:
        """Effects and what is estimated of them, where states tell positions."""
        worlds = self.context.worlds
        sensor = ImageSensor(pi.estimator(G), worlds.task, worlds.frame_stack)
        if self.settings.refine:
            sought = (self.context, k, self.settings, sensor, target, control, G, pi, self.paired_steps)
            return effects_from_known_starts(*sought), []

        def make(seed: int) -> dict:
            found = discover_effects(
                worlds.source_domain, sensor, G, target, [control], self.settings, seed, worlds.image_env,
                self.paired_steps,
            )  # fmt: skip
            return found.to_dict()

        result = self.context.stages.measure(k, "effects", make)
        return result["effects"], result["estimates"]

    def _add(self, k: int, found: list[dict]) -> bool:
        """Add effects to the source. The run folder keeps all so far, as a domain or ``idapt diagnose`` takes them.

        Returns whether there were any.
        """
        worlds, stages = self.context.worlds, self.context.stages
        worlds.add_effects(effect_from_dict(e) for e in found)
        for folder in (stages.folder(k), stages.run_dir):
            write_yaml(folder / "effects.yaml", [e.to_dict() for e in worlds.added_effects])
        return bool(found)
