"""The first phases that runs of a study have in common: same settings, and nothing yet that asks for normals."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from terms import TERMS

from gsjax import config
from gsjax.settings import PLAIN, Phase, Settings, Weights, total_steps
from gsjax.training.plan import PlannedPhase, plan

READS_TABLE = Phase("nothing", 0, Weights(sugar_sdf=1.0))  # no steps: a state with a table of neighbours all the same


def beginning(settings: Settings, others: Sequence[Settings]) -> Settings | None:
    """The run that is the longest beginning which this run shares with another; None where none does.

    It has no normals, which no term has asked for yet, and its rates fall as over the whole run.
    """
    rest, phases = _parted(settings)
    alike = [other for rest_of_other, other in map(_parted, others) if rest_of_other == rest]
    count = max((_in_common(phases, other) for other in alike), default=0)
    if not count:
        return None
    steps = settings.rates.decay_steps or total_steps(settings)
    rates = replace(settings.rates, decay_steps=steps)
    more = (READS_TABLE,) if rest["tables"] else ()
    shared = (*map(_as_asked, phases[:count]), *more)
    return replace(settings, vanilla=False, normals=None, phases=shared, rates=rates)


def _as_asked(phase: PlannedPhase) -> Phase:
    """The phase of settings that is planned like this."""
    return Phase(
        phase.name,
        phase.steps,
        {**dict.fromkeys(PLAIN, 0.0), **{each.name: each.weight for each in phase.terms}},
        image_scale=phase.scale,
        density_control=phase.rule is not None,
        cull_below=phase.cull_below,
        surface_every=phase.surface_every,
    )


def _parted(settings: Settings) -> tuple[dict[str, Any], tuple[PlannedPhase, ...]]:
    """What decides how the phases run, and the phases."""
    planned = plan(settings, TERMS).phases
    described = config.to_dict(replace(settings, vanilla=False, normals=None))
    steps = settings.rates.decay_steps or total_steps(settings)
    # A state whose later terms read the table of neighbours holds it from the start.
    tables = frozenset(table for phase in planned for table in phase.tables)
    return {**described, "phases": None, "steps": steps, "tables": tables}, planned


def _in_common(phases: Sequence[PlannedPhase], others: Sequence[PlannedPhase]) -> int:
    """How many of the first phases are the same, and ask for no normals."""
    for count, (phase, other) in enumerate(zip(phases, others, strict=False)):
        if phase != other or "normals" in phase.needs:
            return count
    return min(len(phases), len(others))
