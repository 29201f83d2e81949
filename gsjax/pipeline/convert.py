"""A file of Gaussians to a file of another format, whole or in part."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import expit

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, take
from gsjax.io.gaussian_files import format_of, load_gaussians, stored_similarity
from gsjax.io.georeference_files import stated_place
from gsjax.io.temporary_files import sweep_beside
from gsjax.meshing.regions import given_numbers
from gsjax.runs.outputs import require_apart


def convert(
    source: str | Path,
    out: str | Path,
    *,
    sh_degree: int | None = None,
    crop: Sequence[float] | None = None,
    min_opacity: float | None = None,
) -> dict[str, Any]:
    """Read Gaussians, keep what is wanted, write them; both formats by the suffixes.

    Args:
        source: .ply, .compressed.ply, .sog or .spz; a run folder means its gaussians.ply.
        out: Likewise, but for the folder.
        sh_degree: Harmonics above this degree, 0-4, are left out. None: all are kept.
        crop: `(x0, y0, z0, x1, y1, z1)`: only Gaussians whose means are in this box of the world, scene units, its
            sides included. The world is that of a PLY, whatever the file. None: all of them.
        min_opacity: Only Gaussians at least so opaque, 0-1. None: all of them.

    Returns:
        `gaussians`: how many were written. `left_out`: how many were not wanted. `clipped`: how many of those written
        hold values that the format cannot reach. `stored_at`: which coordinates a compressed file holds where they are
        not the Gaussians' own (`gsjax.io.gaussian_files`), in words, else None. `sh_degree`, `pixel_filter`, `bytes`:
        of the file.

    Raises:
        InputError: A file cannot be read or written, its suffix is not known, an option is out of range, or
            no Gaussian is wanted.
    """
    source, out = Path(source), Path(out)
    format_of(out)
    require_apart(out, source)
    sweep_beside(out)
    if sh_degree is not None and not 0 <= sh_degree <= 4:
        raise InputError(f"sh_degree={sh_degree} is not between 0 and 4")
    crop = None if crop is None else given_box("crop", crop)
    if min_opacity is not None and not 0 <= min_opacity <= 1:
        raise InputError(f"min_opacity={min_opacity:g} is not between 0 and 1")
    gaussians = load_gaussians(source)
    is_kept = _rows_to_keep(gaussians, crop, min_opacity)
    if not is_kept.any() and len(is_kept):
        raise InputError(f"{source}: none of its {len(is_kept)} Gaussians is left by crop and min_opacity")
    remaining = take(gaussians, is_kept)
    if sh_degree is not None:
        remaining = up_to_degree(remaining, sh_degree)
    place = stated_place(source / "gaussians.ply" if source.is_dir() else source)
    clipped = format_of(out).write(out, remaining, place)
    stored = stored_similarity(out)
    return {
        "gaussians": remaining.num_gaussians,
        "left_out": gaussians.num_gaussians - remaining.num_gaussians,
        "clipped": clipped,
        "stored_at": None if stored.is_identity else stored.summary,
        "sh_degree": remaining.sh_degree,
        "pixel_filter": remaining.pixel_filter,
        "bytes": out.stat().st_size,
    }


def _rows_to_keep(gaussians: Gaussians, crop: Sequence[float] | None, min_opacity: float | None) -> np.ndarray:
    """`[N]` bool: which Gaussians are in the box and opaque enough."""
    is_kept = np.ones(gaussians.num_gaussians, bool)
    if crop is not None:
        means = np.asarray(gaussians.means)
        is_kept &= np.all((means >= np.array(crop[:3])) & (means <= np.array(crop[3:])), axis=1)
    if min_opacity is not None:
        is_kept &= expit(np.asarray(gaussians.logit_opacities, np.float64)) >= min_opacity
    return is_kept


def up_to_degree(gaussians: Gaussians, sh_degree: int) -> Gaussians:
    """The Gaussians without harmonics above a degree."""
    return replace(gaussians, sh_rest=gaussians.sh_rest[:, : (sh_degree + 1) ** 2 - 1])


def given_box(option: str, box: Sequence[float]) -> list[float]:
    """The lower sides of a box that an option was given, then the upper ones.

    Raises:
        InputError: They are not six numbers, or a lower side is above its upper one.
    """
    sides = given_numbers(option, box, 6).tolist()
    if not all(low <= high for low, high in zip(sides[:3], sides[3:], strict=True)):
        raise InputError(f"{option} {' '.join(f'{side:g}' for side in sides)}: a lower side is above its upper one")
    return sides
