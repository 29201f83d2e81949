"""The run in which another of the same scene and seed can begin, so that what both have in common is trained once."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from gsjax import config
from gsjax.settings import Schedule, Settings


def nearest(folders: Iterable[Path], settings: Settings) -> Path | None:
    """Of trained run folders the one that saves a training the most steps; None where none saves any.

    It has the same settings but for the phases, and a checkpoint of steps that both take alike.
    """
    from terms import make_terms

    from gsjax import runs
    from gsjax.runs.run import Run
    from gsjax.training.plan import plan, steps_in_common

    mine, saved = plan(settings, make_terms(lambda: 1.0)).record(), {}
    for folder in filter(runs.is_finished, folders):
        theirs = config.parse(Settings, runs.read_settings(folder), where=f"{folder}/config.json")
        if _beside_phases(theirs) == _beside_phases(settings):
            checkpoint = runs.latest_checkpoint(folder, steps_in_common(Run.open(folder).plan, mine))
            saved |= {checkpoint[0]: folder} if checkpoint else {}
    return saved[max(saved)] if saved else None


def _beside_phases(settings: Settings) -> dict[str, Any]:
    first = Schedule()
    return config.to_dict(settings.replace(schedule={"phases": first.phases, "vanilla": first.vanilla}))
