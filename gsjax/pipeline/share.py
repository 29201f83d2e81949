"""A run or a file of Gaussians as one page that opens anywhere."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, opacities, take
from gsjax.io.packing import MOST_DEGREE
from gsjax.io.temporary_files import sweep_beside
from gsjax.meshing.export import glb_bytes
from gsjax.runs.outputs import require_apart
from gsjax.runs.result import Result, open_result
from gsjax.runs.viewpoints import mean_up, opaque_middle
from gsjax.sharing.page import Shared, write_shared

MOST_BOOKMARKS = 12


def share(
    source: str | Path,
    out: str | Path,
    *,
    title: str | None = None,
    mesh: str | Path | None = None,
    max_gaussians: int | None = None,
    sh_degree: int | None = None,
) -> dict[str, Any]:
    """Write one HTML file with a viewer, the Gaussians, a dozen cameras, and the mesh where there is one.

    Args:
        source: Run folder, or a file of Gaussians.
        out: .html file.
        title: Of the page. None: the name of `source`.
        mesh: .ply, .obj or .glb that the page can show. None: `mesh.glb`, else `mesh.ply`, of a run that has one.
        max_gaussians: Only so many Gaussians: those that cover most, by opacity times area. None: all of them.
        sh_degree: Harmonics above this degree, 0-3, are left out. None: none of them up to 3.

    Returns:
        `gaussians`: how many the page holds, and `left_out`; `bookmarks`: how many cameras; and what
        `gsjax.sharing.page.write_shared` returns.

    Raises:
        InputError: A file cannot be read or written, or an option is out of range.
    """
    source, out = Path(source), Path(out)
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--out {out}: a page ends in .html")
    if max_gaussians is not None and max_gaussians < 1:
        raise InputError(f"--max-gaussians {max_gaussians} is not 1 or more")
    if sh_degree is not None and not 0 <= sh_degree <= MOST_DEGREE:
        raise InputError(f"--sh-degree {sh_degree} is not between 0 and {MOST_DEGREE}")
    require_apart(out, source, mesh)
    sweep_beside(out)
    mesh_file = _mesh_of(source) if mesh is None else Path(mesh)
    glb = None if mesh_file is None else glb_bytes(mesh_file)
    result = open_result(source)
    if not result.gaussians.num_gaussians:
        raise InputError(f"{source}: holds no Gaussians, there is nothing to show")
    remaining = most_visible(result.gaussians, max_gaussians)
    bands = ((MOST_DEGREE if sh_degree is None else sh_degree) + 1) ** 2 - 1
    figures = write_shared(
        out,
        Shared(
            title=source.resolve().name if title is None else title,
            gaussians=replace(remaining, sh_rest=remaining.sh_rest[:, :bands]),
            bookmarks=(bookmarks := thinned(result)),
            middle=opaque_middle(result.gaussians),
            up=mean_up(result.cameras),
            background=np.asarray(result.background),
            similarity=result.similarity,
            glb=glb,
        ),
    )
    left_out = result.gaussians.num_gaussians - remaining.num_gaussians
    return {"gaussians": remaining.num_gaussians, "left_out": left_out, "bookmarks": len(bookmarks), **figures}


def most_visible(gaussians: Gaussians, most: int | None) -> Gaussians:
    """The Gaussians, at most so many, whose opacity times area of the larger two axes is largest; in their order."""
    if most is None or gaussians.num_gaussians <= most:
        return gaussians
    log_scales = np.sort(np.asarray(gaussians.log_scales, np.float64), axis=1)
    cover = np.log(np.maximum(np.asarray(opacities(gaussians)), 1e-12)) + log_scales[:, 1:].sum(axis=1)
    return take(gaussians, np.sort(np.argsort(-cover, kind="stable")[:most]))


def thinned(result: Result) -> list[tuple[str, Any]]:
    """Names and cameras of at most a dozen views, evenly spread over all."""
    count = len(result.cameras)
    places = np.unique(np.linspace(0, count - 1, min(MOST_BOOKMARKS, count)).round().astype(int))
    return [(result.names[place], result.cameras[place]) for place in places]


def _mesh_of(source: Path) -> Path | None:
    """The mesh that a run folder holds, the textured one where there are two."""
    files = [source / name for name in ("mesh.glb", "mesh.ply") if source.is_dir() and (source / name).is_file()]
    return files[0] if files else None
