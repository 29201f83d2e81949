"""The first phases that runs of a study have in common: same settings, and nothing yet that asks for normals."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from gsjax import config
from gsjax.settings import Phase, Settings, Weights, total_steps
from gsjax.training.loop import planned_phases
from gsjax.training.step import active_terms
from gsjax.training.surroundings import needed
from gsjax.training.terms.losses import NEEDS_NORMALS

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
    more = (READS_TABLE,) if any(map(needed, phases)) else ()
    return replace(settings, vanilla=False, normals=None, phases=(*phases[:count], *more), rates=rates)


def _parted(settings: Settings) -> tuple[dict[str, Any], tuple[Phase, ...]]:
    """What decides how the phases run, and the phases."""
    phases = planned_phases(settings)
    described = config.to_dict(replace(settings, vanilla=False, normals=None))
    steps = settings.rates.decay_steps or total_steps(settings)
    # A state whose later terms read the table of neighbours holds it from the start.
    return {**described, "phases": None, "steps": steps, "table": any(map(needed, phases))}, phases


def _in_common(phases: Sequence[Phase], others: Sequence[Phase]) -> int:
    """How many of the first phases are the same, and ask for no normals."""
    for count, (phase, other) in enumerate(zip(phases, others, strict=False)):
        if phase != other or not NEEDS_NORMALS.isdisjoint(active_terms(phase.weights)):
            return count
    return min(len(phases), len(others))
