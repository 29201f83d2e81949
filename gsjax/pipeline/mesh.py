"""Gaussians to a mesh file."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from gsjax import gallery
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.meshing.export import supported_suffix, write_mesh
from gsjax.meshing.extract import extract_mesh
from gsjax.pipeline.result import open_result


def mesh(
    source: str | Path,
    out: str | Path,
    *,
    depth: int | None = None,
    trim_quantile: float = 0.0,
    level: float = 0.3,
    points: int = 300_000,
    bounds: list[float] | None = None,
    scene: str | Path | None = None,
) -> dict[str, Any]:
    """Extract the mesh of a run, or of any 3DGS .ply.

    Args:
        source: Run folder or .ply.
        out: Mesh file; .ply, .obj or .glb.
        depth: Of the Poisson octree. None: chosen from the sizes of the Gaussians.
        trim_quantile: Share of the least supported vertices to cut away.
        level: Density at which the surface lies.
        points: Most surface points.
        bounds: x0 y0 z0 x1 y1 z1 of the box to keep, scene coordinates.
        scene: Data set whose cameras to use with a .ply.

    Returns:
        A report of plain numbers: `vertices`, `faces` and what `extract_mesh` says.

    Raises:
        InputError: Nothing to mesh, or a file cannot be read or written.
    """
    supported_suffix(Path(out))
    if not 0 < level < 1:
        raise InputError(f"--level {level} is not between 0 and 1")
    if not 0 <= trim_quantile < 1:
        raise InputError(f"--trim-quantile {trim_quantile} is not in 0..1")
    if points < 1:
        raise InputError(f"--points {points} is below 1")
    if depth is not None and not 2 <= depth <= 14:
        raise InputError(f"--depth {depth} is not between 2 and 14")
    result = open_result(source, scene=scene)
    cameras = [c for c, held_out in zip(result.cameras, result.held_out, strict=True) if not held_out]
    pictures = list(gallery.pictures(without_view_dependence(result.gaussians), cameras, result.background))
    surface, report = extract_mesh(
        result.gaussians,
        cameras,
        [p.depth for p in pictures],
        [p.alphas for p in pictures],
        [p.colors for p in pictures],
        level=level,
        num_points=points,
        bounds=None if bounds is None else (np.array(bounds[:3]), np.array(bounds[3:])),
        depth=depth,
        trim_quantile=trim_quantile,
    )
    write_mesh(out, surface)
    return {"vertices": len(surface.vertices), "faces": len(surface.faces), **report}


def without_view_dependence(gaussians: Gaussians) -> Gaussians:
    """The same Gaussians with their constant colour alone: what a surface is painted with."""
    return Gaussians(**{**gaussians.__dict__, "sh_rest": jnp.zeros_like(jnp.asarray(gaussians.sh_rest))})
