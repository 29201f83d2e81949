"""Another run, in whose last checkpoint of steps in common a training begins."""

import shutil
from pathlib import Path

from gsjax import runs
from gsjax.errors import InputError
from gsjax.io.files import atomic_folder
from gsjax.runs.run import Run
from gsjax.training.plan import Plan, steps_in_common


def shared_steps(warm_start: Path, planned: Plan) -> int:
    """How many steps a plan has in common with a run.

    Raises:
        InputError: The run has no checkpoint of them.
    """
    steps = steps_in_common(Run.open(warm_start).plan, planned.record())
    if runs.latest_checkpoint(warm_start, steps) is None:
        raise InputError(f"{warm_start}: has no checkpoint of the {steps} steps that this run has in common with it")
    return steps


def take_normals(warm_start: Path, run: Path, planned: Plan, step: int) -> None:
    """Copies the normals that steps before `step` were compared with: drawn from later Gaussians they were others."""
    source, target = warm_start / "normals", run / "normals"
    read_before = any("normals" in phase.needs and phase.begin < step for phase in planned.phases)
    if read_before and source.is_dir() and not target.exists():
        with atomic_folder(target) as folder:
            shutil.copytree(source, folder, dirs_exist_ok=True)
