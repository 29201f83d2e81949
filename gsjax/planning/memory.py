"""What a run takes of the machine's memory, and how it gets along with less: slower, not dead."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from gsjax.io.machine import free_memory
from gsjax.io.temporary_files import ArraysOnDisk
from gsjax.rendering.engine import computes_on_cpu
from gsjax.scene import Frame, Keep, in_memory
from gsjax.training.plan import Plan, PlannedPhase

PIXEL, MASKED, NORMALS, MEASURED = 3, 1, 3, 5  # bytes of a photo's pixel, of its mask, and of maps beside it
# Bytes on a CPU beside photos and maps, measured by experiments/benchmarks/training_memory.py:
PROGRAMS = 1.25 * 2**30  # what jax, compiling and reading photos take
A_ROW = 4600  # a Gaussian with its moments, its gradient and what a step makes of it
A_PIXEL = 1000  # of the photo that a step looks at, and of another beside it
FEWEST = 10_000  # Gaussians, below which no run is brought
GIB = 2**30


class MemoryFit(NamedTuple):
    """A run that fits into this machine's memory."""

    plan: Plan  # perhaps of fewer Gaussians
    keep: Keep  # where photos and maps are
    lines: tuple[str, ...]  # what is slower or less, for the user


def fit_to_memory(planned: Plan, frames: Sequence[Frame], folder: Path, *, may_lower: bool) -> MemoryFit:
    """Fit a run into this machine's memory.

    Photos and maps that do not fit next to the Gaussians are on the disk of `folder`, from where each step reads its
    own: the numbers are the same. Where the Gaussians alone do not fit, fewer may grow (`may_lower`), though not in a
    run that is resumed. A GPU's own memory is not considered.
    """
    rows = planned.max_gaussians if computes_on_cpu() else 0
    free = free_memory()
    keep, lines = keep_photos(photo_bytes(planned, frames), frames, rows, folder, free)
    most = max(int((free - PROGRAMS - _step_bytes(frames)) / A_ROW), FEWEST)
    if not (lines and may_lower and most < rows):
        return MemoryFit(planned, keep, lines)
    fewer = f"memory: at most {most:,} Gaussians, instead of max_gaussians={rows:,}"
    return MemoryFit(replace(planned, max_gaussians=most), keep, (*lines, fewer))


def keep_photos(
    photos: int, frames: Sequence[Frame], rows: int, folder: Path, free: int
) -> tuple[Keep, tuple[str, ...]]:
    """Where so many bytes of photos and their maps are: in memory if they fit there, else on the disk, with a line.

    `rows` are Gaussians in the same memory, of which so many bytes are free.
    """
    gaussians = A_ROW * rows
    if PROGRAMS + _step_bytes(frames) + gaussians + photos <= free:
        return in_memory, ()
    more = f" and Gaussians up to {gaussians / GIB:.3g}" if rows else ""
    return ArraysOnDisk(folder), (
        f"memory: {max(free, 0) / GIB:.3g} GiB are free, photos and maps take {photos / GIB:.3g}{more}:"
        " each step reads its photo from the disk",
    )


def photo_bytes(planned: Plan, frames: Sequence[Frame]) -> int:
    """Bytes of photos, their smaller copies and maps in the phase that holds most of them."""
    pixels = plain_bytes(frames)
    plain = sum(frame.width * frame.height for frame in frames)

    def beside(phase: PlannedPhase) -> float:
        scales = {phase.scale, phase.scale * phase.surface_scale}
        copies = sum(pixels / scale**2 for scale in scales if scale > 1)
        smaller = 1 / max(scales) ** 2  # of normals both the full maps and what steps read of them
        normals = NORMALS * (1 + smaller * (max(scales) > 1)) * ("normals" in phase.needs)
        return copies + plain * (normals + MEASURED * smaller * ("measured" in phase.needs))

    return int(pixels + max(map(beside, planned.phases)))


def plain_bytes(frames: Sequence[Frame]) -> int:
    """What photos and their masks take."""
    return sum((PIXEL + MASKED * frame.masked) * frame.width * frame.height for frame in frames)


def _step_bytes(frames: Sequence[Frame]) -> int:
    return A_PIXEL * max(frame.width * frame.height for frame in frames)
