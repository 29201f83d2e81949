"""A run that keeps as many harmonics as its photos need: tried where no Gaussians multiply any more."""

import sys
from dataclasses import replace
from pathlib import Path

from gsjax import runs
from gsjax.io import json_files
from gsjax.training import harmonics
from gsjax.training.loop import Work, follow
from gsjax.training.plan import Plan
from gsjax.training.state import TrainState

ENTRY = "harmonics"
"""Of the manifest: `degree`, and `psnr` of photos that were kept from the colours, by degree."""


def with_needed_harmonics(run: Path, work: Work, state: TrainState, capacity: int | None) -> TrainState:
    """The state after the phases of density control, with the smallest degree that predicts photos as well as any.

    A state that is further on has been through this, and stays.

    Args:
        run: Run folder; its manifest keeps what was found.
        work: The run; a phase comes after those of density control.
        state: Where the run is.
        capacity: Pair buffer to continue with; None counts.
    """
    growing = work.plan.until(work.plan.grown or 0)
    if int(state.step) > growing.steps:
        return state
    state = follow(replace(work, plan=growing), state, capacity)
    found = harmonics.score_degrees(work.plan, growing.phases[-1], work.frames, state, work.extent, work.effects)
    degree = harmonics.smallest_good_degree(found)
    told = ", ".join(f"{psnr:.2f}" for psnr in found.values())
    print(f"train: harmonics of degree {degree} go on: {told} dB with 0 to {max(found)}", file=sys.stderr)
    runs.update_manifest(run, **{ENTRY: {"degree": degree, "psnr": found}})
    return harmonics.cut_bands(state, work.optimizer, degree)


def stored_degree(run: Path, plan: Plan, degree: int) -> int:
    """The degree that the newest checkpoint of a run holds: `degree`, the run's own, until another was found needed."""
    newest = runs.latest_checkpoint(run)
    known = json_files.read(run / "manifest.json").get(ENTRY)
    if newest is None or known is None or plan.grown is None or newest[0] <= plan.until(plan.grown).steps:
        return degree
    return known["degree"]
