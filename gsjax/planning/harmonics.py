"""A run that keeps as many harmonics as its photos need: tried where no Gaussians multiply any more."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import optax

from gsjax import runs
from gsjax.effects.model import Effects
from gsjax.io import json_files
from gsjax.planning.effects import grown
from gsjax.scene import Frame
from gsjax.settings import Settings
from gsjax.training import harmonics
from gsjax.training.loop import planned_phases
from gsjax.training.state import TrainState

ENTRY = "harmonics"
"""Of the manifest: `degree`, and `psnr` of photos that were kept from the colours, by degree."""


def with_needed_harmonics(
    run: Path,
    settings: Settings,
    frames: Sequence[Frame],
    extent: float,
    state: TrainState,
    optimizer: optax.GradientTransformation,
    effects: Effects,
    fitted: Callable[..., TrainState],
) -> TrainState:
    """The state after the phases of density control, with the smallest degree that predicts photos as well as any.

    A state that is further on has been through this, and stays.

    Args:
        run: Run folder; its manifest keeps what was found.
        settings: The run; a phase comes after those of density control.
        frames: The photos that are trained on.
        extent: Camera extent, scene units.
        state: Where the run is.
        optimizer: Of the state.
        effects: Of the state.
        fitted: Runs the phases of settings on a `state`.
    """
    phases = planned_phases(settings)[: grown(settings)]
    if int(state.step) > sum(phase.steps for phase in phases):
        return state
    state = fitted(replace(settings, phases=phases), state=state)
    found = harmonics.degrees_tried(settings, phases[-1], frames, state, extent, effects)
    degree = harmonics.smallest(found)
    told = ", ".join(f"{psnr:.2f}" for psnr in found.values())
    print(f"train: harmonics of degree {degree} go on: {told} dB with 0 to {max(found)}", file=sys.stderr)
    runs.update_manifest(run, **{ENTRY: {"degree": degree, "psnr": found}})
    return harmonics.cut(state, optimizer, degree)


def stored_degree(run: Path, settings: Settings) -> int:
    """The degree that the newest checkpoint of a run holds: the run's own until another was found needed."""
    newest = runs.latest_checkpoint(run)
    steps = sum(phase.steps for phase in planned_phases(settings)[: grown(settings)])
    known = json_files.read(run / "manifest.json").get(ENTRY)
    return settings.sh_degree if newest is None or newest[0] <= steps or known is None else known["degree"]
