"""What will run, decided once: phases with their steps, sizes, terms and rules, from settings and the run's own facts.

Loop, budget, pace, report and resume read a plan; settings stay as the user gave them.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Self, TypeVar

from jax import Array

from gsjax.effects.kinds import effect_kinds
from gsjax.errors import InputError
from gsjax.scene import Frame
from gsjax.settings import PLAIN, Density, Logging, Phase, Rates, Schedule, Settings, Supervision
from gsjax.training.densification.rules import DENSIFICATION_RULES, DensificationRule, rule_named
from gsjax.training.terms import TERMS, LossTerm, Term, needs, weigh_terms, weights_of_data
from gsjax.training.terms.checking import as_terms, check_term, shapes_of_training

T = TypeVar("T", Density, Logging)

RATES = "means", "sh_rest", "scales", "quats"
"""The fields of `Rates` that are rates."""
SKY_WEIGHT = 0.1  # of the term `sky`: ours, as that of `alpha`


@dataclass(frozen=True)
class PlannedPhase:
    """A stretch of training with fixed terms: one compiled step."""

    name: str
    begin: int  # steps of the run before its first one
    end: int  # and after its last one
    scale: int  # photos are so many times smaller in each direction
    terms: tuple[LossTerm, ...]  # of non-zero weight
    rule: DensificationRule | None = None  # of densification; None: none
    cull_below: float = 0.0  # at the end, Gaussians of lower opacity are removed
    surface_every: int = 1  # one of so many steps has the surface terms
    surface_scale: int = 1  # photos of those steps are so many times smaller still
    dropout: float = 0.0  # share of the Gaussians that each step leaves out

    @property
    def steps(self) -> int:
        """How many."""
        return self.end - self.begin

    @property
    def needs(self) -> frozenset[str]:
        """What its terms need, words of `gsjax.training.terms.NEEDS`."""
        return needs(self.terms)

    @property
    def image_terms(self) -> tuple[LossTerm, ...]:
        """The terms without the surface terms."""
        return tuple(each for each in self.terms if not each.is_surface)


@dataclass(frozen=True)
class Plan:
    """What will run."""

    phases: tuple[PlannedPhase, ...]
    seed: int
    background: str  # of `gsjax.training.step.BACKGROUNDS`
    depth_mode: str  # of `gsjax.rendering`
    views_per_step: int
    max_gaussians: int
    sh_every: int  # steps between the bands of the SH ramp
    rates: Rates  # their `decay_steps` are known
    density: Density
    logging: Logging
    downscale: float = 1.0  # photos are so many times smaller than they were taken
    normals: str | None = None  # folder of the maps; None: those of the run's own depth, where a term asks for any
    effects: tuple[str, ...] = ()  # that are simulated
    stereo_points: int = 0  # that are looked for before the first step, see `gsjax.stereo`
    rule: DensificationRule = DENSIFICATION_RULES["adc"]  # of the phases that densify

    @property
    def steps(self) -> int:
        """Of all phases."""
        return self.phases[-1].end

    @property
    def photos_seen(self) -> int:
        """By all steps."""
        return self.steps * self.views_per_step

    @property
    def needs(self) -> frozenset[str]:
        """What the terms of any phase need, words of `gsjax.training.terms.NEEDS`."""
        return frozenset(word for phase in self.phases for word in phase.needs)

    @property
    def grown(self) -> int | None:
        """How many phases have run after the last one that densifies; None where it is the last of all."""
        last = max((count for count, phase in enumerate(self.phases, 1) if phase.rule), default=0)
        return last if last < len(self.phases) else None

    def with_effects(self, names: Iterable[str]) -> Self:
        """The plan of a run that simulates these effects: some delay densification, or add a term of the loss."""
        planned, growing = replace(self, effects=tuple(names)), sum(phase.steps for phase in self.phases if phase.rule)
        for name, kind in effect_kinds().items():
            if name in planned.effects and kind.delay_densification is not None:
                planned = replace(planned, density=kind.delay_densification(planned.density, growing))
            if name in planned.effects and kind.masked_terms is not None:
                planned = planned.with_terms(weights_of_data(kind.masked_terms, SKY_WEIGHT))
        return planned

    def with_terms(self, weights: Mapping[str, float]) -> Self:
        """The plan whose phases have these terms as well; of one that a phase has already the larger weight counts."""
        phases = []
        for phase in self.phases:
            heaviest = {each.name: each for each in phase.terms}
            for each in weigh_terms(weights):
                if each.name not in heaviest or each.weight > heaviest[each.name].weight:
                    heaviest[each.name] = each
            phases.append(replace(phase, terms=tuple(heaviest.values())))
        return replace(self, phases=tuple(phases))

    def without(self, need: str) -> Self:
        """The plan without the terms that need this, a word of `gsjax.training.terms.NEEDS`."""
        phases = (
            replace(phase, terms=tuple(each for each in phase.terms if need not in each.term.needs))
            for phase in self.phases
        )
        return replace(self, phases=tuple(phases))

    def record(self) -> dict[str, Any]:
        """The plan as `RUN/plan.json` has it."""
        phases = [
            phase_record(
                phase.name,
                phase.steps,
                {each.name: each.weight for each in phase.terms},
                phase.needs,
                begin=phase.begin,
                end=phase.end,
                scale=phase.scale,
                surface_every=phase.surface_every,
                surface_scale=phase.surface_scale,
                density_control=phase.rule is not None,
                cull_below=phase.cull_below,
                **({"dropout": phase.dropout} if phase.dropout else {}),
            )
            for phase in self.phases
        ]
        return plan_record(
            phases,
            self.downscale,
            self.normals,
            views_per_step=self.views_per_step,
            max_gaussians=self.max_gaussians,
            effects=self.effects,
        )


LENGTH = {"steps", "end"}
"""What is known of a phase only because it is so long."""


def phase_record(
    name: str, steps: int, terms: Mapping[str, float], needs: Iterable[str], **more: Any
) -> dict[str, Any]:
    """A phase as `plan.json` has it, of a training or a refinement: what every reader relies on, then what is known.

    `terms` are weights by name; `needs` are words of `gsjax.training.terms.NEEDS`.
    """
    return {"name": name, "steps": steps, "terms": dict(terms), "needs": sorted(needs), **more}


def plan_record(
    phases: Sequence[Mapping[str, Any]], downscale: float, normals: str | None, **more: Any
) -> dict[str, Any]:
    """What `plan.json` holds, see `phase_record` and `Plan`; `gsjax.runs.records.PLAN` is the shape of it."""
    steps = sum(phase["steps"] for phase in phases)
    return {"steps": steps, "downscale": downscale, "normals": normals, **more, "phases": list(phases)}


def steps_in_common(one: Mapping[str, Any], other: Mapping[str, Any]) -> int:
    """After how many steps two runs part, by their plans' records (see `plan_record`): where their phases first differ.

    Of the last phase in common the shorter of both counts.
    """
    steps = 0
    for phases in zip(one["phases"], other["phases"], strict=False):
        mine, others = ({key: value for key, value in phase.items() if key not in LENGTH} for phase in phases)
        if mine != others:
            break
        steps += min(phase["steps"] for phase in phases)
        if phases[0]["steps"] != phases[1]["steps"]:
            break
    return steps


def plan(
    settings: Settings,
    terms: Mapping[str, Term | Callable[..., Array]] = MappingProxyType({}),
    densification: DensificationRule | None = None,
) -> Plan:
    """The plan of a run.

    Steps of several views are fewer: what is counted in steps comes after as many photos as with one. The rates grow
    with the square root of the views: Adam divides by the gradient's size, and a mean over V views is nearer to the
    true one by that root (Zhao et al., On Scaling Up 3D Gaussian Splatting Training). What its moments remember is the
    optimiser's matter (`gsjax.training.optimizers.make_optimizer`).

    Args:
        settings: Of the user.
        terms: The run's own loss terms by name, in addition to the library's or in their place. What a bare function
            needs is found out.
        densification: The run's own rule; None: the one that `density.rule` names.

    Raises:
        InputError: A weight has no term, or a term needs data that the run does not have.
    """
    all_terms = {**TERMS, **as_terms(terms, shapes_of_training)}
    rule = densification or rule_named(settings.density.rule)
    schedule, views = settings.schedule, settings.schedule.views_per_step
    phases, begin = [], 0
    for phase in schedule.phases:
        phase_terms = _weighed(phase, all_terms, settings.supervision, vanilla=schedule.vanilla)
        phases.append(_planned_phase(phase, begin, schedule, phase_terms, rule))
        begin = phases[-1].end
    return Plan(
        phases=tuple(phases),
        seed=settings.seed,
        background=settings.model.background,
        depth_mode=settings.model.depth_mode,
        views_per_step=views,
        max_gaussians=settings.model.max_gaussians,
        sh_every=_fewer(schedule.sh_every, views),
        rates=_rates(settings.rates, views, begin),
        density=_in_steps(settings.density, views, "start", "stop", "every", "reset_every"),
        logging=_in_steps(settings.logging, views, "metrics_every", "evaluate_every", "checkpoint_every"),
        stereo_points=0 if schedule.vanilla else settings.model.stereo_points,
        rule=rule,
    )


def check_terms(planned: Plan, frames: Sequence[Frame]) -> None:
    """Try the run's own terms on the shapes that they will see, each by itself, before anything is read or compiled.

    Raises:
        InputError: A term reads what it does not need, fails, or is not one float.
    """
    width, height = (max(getattr(frame, side) for frame in frames) for side in ("width", "height"))
    cases = {
        (each, width // scale, height // scale)
        for phase in planned.phases
        for terms, scale in ((phase.terms, phase.scale * phase.surface_scale), (phase.image_terms, phase.scale))
        for each in terms
        if each.term not in TERMS.values()
    }
    for each, wide, high in sorted(cases, key=lambda one: (one[0].name, one[1:])):
        if wide and high:  # A phase that leaves nothing of the photos is refused where they are read.
            check_term(each, shapes_of_training(wide, high, planned.depth_mode))


def _planned_phase(
    phase: Phase, begin: int, schedule: Schedule, terms: tuple[LossTerm, ...], rule: DensificationRule
) -> PlannedPhase:
    planned = PlannedPhase(
        phase.name,
        begin,
        begin + _fewer(phase.steps, schedule.views_per_step),
        phase.image_scale,
        terms,
        rule if phase.density_control else None,
        0.0 if schedule.vanilla else phase.cull_below,
        dropout=schedule.dropout,
    )
    if not any(each.is_surface for each in terms):
        return planned
    return replace(planned, surface_every=phase.surface_every, surface_scale=phase.surface_scale)


def _weighed(
    phase: Phase, terms: Mapping[str, Term], supervision: Supervision, *, vanilla: bool
) -> tuple[LossTerm, ...]:
    """The terms of a phase, whose data the run has; of vanilla 3DGS those of the image alone."""
    is_measured = supervision.depth is not None
    weight = supervision.depth_weight if is_measured else supervision.stereo_weight
    everywhere = weights_of_data("measured", weight)
    where = f"schedule.phases.{phase.name}"
    try:
        weighed = weigh_terms({**everywhere, **phase.weights}, terms)
    except InputError as error:
        raise InputError(f"{where}.{error}") from error
    weighed = tuple(each for each in weighed if each.name in PLAIN or not vanilla)
    for each in weighed:
        if not (is_measured or supervision.stereo_weight) and "measured" in each.term.needs:
            raise InputError(f"{where}.weights.{each.name}: needs measured depth (supervision.depth)")
        if "sky" in each.term.needs:
            raise InputError(f"{where}.weights.{each.name}: the effect sky adds this term where photos show sky")
        if "mesh" in each.term.needs:
            raise InputError(f"{where}.weights.{each.name}: only a refinement has a mesh")
    return weighed


def _fewer(steps: int, views: int) -> int:
    return math.ceil(steps / views)


def _rates(rates: Rates, views: int, steps: int) -> Rates:
    grown = {name: math.sqrt(views) * getattr(rates, name) for name in RATES} if views > 1 else {}
    decay = steps if rates.decay_steps is None else _fewer(rates.decay_steps, views)
    return replace(rates, **grown, decay_steps=decay)


def _in_steps(record: T, views: int, *names: str) -> T:
    """A record with fields that count photos, in steps of so many views."""
    return replace(record, **{name: _fewer(getattr(record, name), views) for name in names})
