"""Warm start from another run's last common checkpoint, and resuming with the same terms, effects and rule."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gsjax import runs
from gsjax.errors import InputError
from gsjax.io.files import atomic_folder
from gsjax.runs.run import Run
from gsjax.training.plan import Plan, steps_in_common

ENTRY = "handed_in"
"""Key of the manifest: names of the user's terms and effects, and whether there is a rule of densification."""


def shared_steps(warm_start: Path, planned: Plan) -> int:
    """Return how many steps a plan has in common with a run.

    Raises:
        InputError: The run has no checkpoint of them.
    """
    steps = steps_in_common(Run.open(warm_start).plan, planned.record())
    if runs.latest_checkpoint(warm_start, steps) is None:
        raise InputError(f"{warm_start}: has no checkpoint of the {steps} steps that this run has in common with it")
    return steps


def copy_normals(warm_start: Path, run: Path, planned: Plan, step: int) -> None:
    """Copy the normals that supervised the steps before `step`; normals of later Gaussians would differ."""
    source, target = warm_start / "normals", run / "normals"
    read_before = any("normals" in phase.needs and phase.begin < step for phase in planned.phases)
    if read_before and source.is_dir() and not target.exists():
        with atomic_folder(target) as folder:
            shutil.copytree(source, folder, dirs_exist_ok=True)


def pieces_record(terms: Mapping[str, Any], densification: Any, effects: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entry of the manifest; an empty one without terms, effects or rule of the user."""
    record = {"terms": sorted(terms), "effects": sorted(effects), "densification": densification is not None}
    return {ENTRY: record} if any(record.values()) else {}


def require_pieces(run: Run, record: Mapping[str, Any]) -> None:
    """Raise InputError if a run would resume with other pieces than at its start, see `pieces_record`."""
    started = run.manifest.get(ENTRY)
    if started != record.get(ENTRY):
        raise InputError(
            f"{run.folder}: was started with {_as_arguments(started)}, not with {_as_arguments(record.get(ENTRY))};"
            " resume it with the same"
        )


def _as_arguments(record: Mapping[str, Any] | None) -> str:
    """A record as arguments of `gsjax.train`."""
    if record is None:
        return "no terms=, effects= or densification="
    names = [f"{kind}={{{', '.join(record[kind])}}}" for kind in ("terms", "effects") if record[kind]]
    return ", ".join(names + ["densification="] * record["densification"])
