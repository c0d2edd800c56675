"""The worlds of one run: source, grounded source, and the target as each part of the run may see it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from idapt_pl.effects import WHOLE, Domain, Effect, View
from idapt_pl.effects.distribution import ALWAYS_THE_SAME, DomainDistribution
from idapt_pl.envs import ActionMap, BlindTarget, GroundedEnv, ImageEnv, VectorImageEnv, VectorStateEnv
from idapt_pl.envs.ledger import Ledger
from idapt_pl.modules import ActionTransformation, VisualTransformation
from idapt_pl.randomisation.settings import draw_variants
from idapt_pl.targets import Look, SimulatedTarget, Target
from idapt_pl.tasks import Task


@dataclass
class Worlds:
    """Makes the environments of a run, all with the same image size and frame stack.

    The source is what its domain says and what :meth:`add_effects` has added since. Where policies train
    (:meth:`training_source`) it may be randomised: variants of it, drawn from ``distribution`` by ``variant_seed``.
    """

    task: Task
    source_domain: Domain
    target: Target
    ledger: Ledger
    image_size: int
    frame_stack: int
    view: View = WHOLE
    render_processes: int = 0
    distribution: DomainDistribution = ALWAYS_THE_SAME
    variant_count: int = 32
    variant_seed: int = 0
    known_effects: Sequence[Effect] = ()

    def add_effects(self, effects: Iterable[Effect]) -> None:
        """Add effects to the source, for all environments made from now on."""
        self.source_domain = self.source_domain.with_effects(*effects)

    @property
    def added_effects(self) -> tuple[Effect, ...]:
        """Effects that were added to the source."""
        return self.source_domain.effects[len(self.task.domain("source").effects) :]

    @property
    def first_source(self) -> Domain:
        """The source that the run began with, known effects included; what explores acts in it throughout."""
        return self.task.domain("source").with_effects(*self.known_effects)

    def source(self, num_envs: int, whole: bool = False) -> VectorImageEnv:
        """The source: images, state, reward; ``whole`` simulations can be restored."""
        return self.look.simulate(self.task, self.source_domain, num_envs, whole=whole)

    @property
    def variants(self) -> tuple[Domain, ...]:
        """The worlds that policies train in: variants of the source as it is now; none where that is not randomised."""
        return draw_variants(self.distribution, self.source_domain, self.variant_count, self.variant_seed)

    def training_source(self, num_envs: int, whole: bool = False) -> VectorImageEnv:
        """The source as policies train in it: randomised, if the run's is."""
        return self.look.simulate(self.task, self.source_domain, num_envs, self.variants, whole)

    def source_states(self, num_envs: int) -> VectorStateEnv:
        """The source: state and reward; nothing is rendered."""
        return VectorStateEnv(self.task, self.source_domain, num_envs)

    def training_states(self, num_envs: int, horizon: int = 0) -> VectorStateEnv:
        """As :meth:`training_source`, with state and reward; nothing is rendered. Episodes may be cut early."""
        return VectorStateEnv(self.task, self.source_domain, num_envs, self.variants, horizon)

    def grounded(
        self, num_envs: int, G: VisualTransformation | None = None, F: ActionTransformation | None = None
    ) -> GroundedEnv:
        """The source seen through G and moved through F; None is the identity."""
        return self.grounded_over(self.source(num_envs), G, F)

    @staticmethod
    def grounded_over(
        source: VectorImageEnv, G: VisualTransformation | None, F: ActionTransformation | None
    ) -> GroundedEnv:
        """As :meth:`grounded`, over simulations of the source that are there already."""
        return GroundedEnv(
            source,
            G=G.translate if G is not None else None,
            F=F.transform if F is not None else None,
            frames=G.frames if G is not None else 1,
        )

    @property
    def views_apart(self) -> str:
        """What to know if ``view`` cuts the source's images and not the target's; empty if it does not."""
        if self.view == WHOLE or self.target.viewed:
            return ""
        return (
            f"view {{share: {self.view.share:g}, up: {self.view.up:g}, right: {self.view.right:g}}} cuts the source's "
            f"images, while of {self.target.name} the middle square is shown. Unless its camera shows just that part, "
            "give view: {share: 1, up: 0}"
        )

    def blind_target(self, step: int) -> BlindTarget:
        """The target as training may see it: one robot, images and actions only, every step counted."""
        return BlindTarget(self.rewarded_target(1, asking=False), self.ledger, step, "training")

    def rewarded_target(self, num_envs: int, asking: bool = True) -> ImageEnv:
        """The target with its reward: for evaluation and the oracle reference, never for the method.

        There are ``num_envs`` of it, or the one robot that there is. A person who judges it is asked where an episode
        ends, unless not ``asking``.
        """
        return self.target.with_reward(num_envs, self.look, asking)

    def look_for_target(self, recorded: Collection[int] = ()) -> None:
        """See whether the target is there, as far as that can be known without playing it.

        Args:
            recorded: grounding steps of which the run has its recordings.
        """
        self.target.look_for(self.look, recorded)

    def target_twin(self) -> VectorImageEnv | None:
        """A simulation of the target that can be put into the source's states, for evaluation; None without one."""
        return self.target.posable_twin(self.look)

    def image_env(self, domain: Domain, num_envs: int) -> VectorImageEnv:
        """A domain as the run's images show it."""
        return self.look.simulate(self.task, domain, num_envs)

    @property
    def actions(self) -> ActionMap:
        """What the target is told for the policy's actions."""
        return self.target.actions

    @property
    def look(self) -> Look:
        """How the run looks at its worlds."""
        return Look(self.image_size, self.frame_stack, self.view, self.render_processes)

    @property
    def target_domain(self) -> Domain:
        """The target domain.

        Raises:
            ValueError: of targets that are none of the task's domains.
        """
        if not isinstance(self.target, SimulatedTarget):
            raise ValueError(
                f"the target {self.target.name} is no domain of {self.task.name}: nothing of its model is known"
            )
        return self.target.domain

    @property
    def dimensions(self) -> dict[str, Any]:
        """What the modules' constructors take from the task and the data."""
        env = self.source(1)
        env.close()
        sizes = {"state_dim": env.state_dim, "image_size": self.image_size, "frame_stack": self.frame_stack}
        return sizes | {"rates": dict(self.task.rates), "dt": env.dt}

    @property
    def period(self) -> float:
        """Control period, s."""
        return self.task.period(self.source_domain.compile())

    @property
    def action_bounds(self) -> dict[str, list[float]]:
        """Action bounds, as the modules' constructors name them."""
        low, high = self.source_domain.compile().actuator_ctrlrange.T
        return {"action_low": low.tolist(), "action_high": high.tolist()}
