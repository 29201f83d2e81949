"""A run or a file of Gaussians as one page that opens anywhere.

The viewer is `gsjax/sharing/templates/share.js`. It draws by Spark and three.js, which `vendor/libraries.min.js.gz` in
`gsjax/sharing` holds.
"""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gsjax import sharing
from gsjax.errors import InputError
from gsjax.gaussians import SH_C0, Gaussians, opacities, take
from gsjax.io import json_files
from gsjax.io.packing import MOST_DEGREE
from gsjax.io.spz import spz_bytes
from gsjax.io.temporary_files import sweep_beside
from gsjax.meshing.export import glb_bytes
from gsjax.pipeline.convert import up_to_degree
from gsjax.report.page import write_page
from gsjax.runs.outputs import require_apart
from gsjax.runs.result import Result, open_result
from gsjax.runs.viewpoints import evenly_spread, mean_up, opaque_middle
from gsjax.scene.cameras import viewmat_center

LIBRARIES = Path(sharing.__file__).parent / "vendor" / "libraries.min.js.gz"
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
        `gaussians`: how many the page holds, and `left_out`; `bookmarks`: how many cameras; `clipped`: how many
        Gaussians hold values that SPZ cannot reach. Bytes within the page, each a third larger than by itself:
        `splats`, `mesh` and `viewer`; and of all of it: `bytes`.

    Raises:
        InputError: A file cannot be read or written, or an option is out of range.
    """
    source, out = Path(source), Path(out)
    _check(out, max_gaussians, sh_degree)
    require_apart(out, source, mesh)
    sweep_beside(out)
    glb = _mesh_bytes(source, mesh)
    result = open_result(source)
    if not result.gaussians.num_gaussians:
        raise InputError(f"{source}: holds no Gaussians, there is nothing to show")
    remaining = _most_visible(result.gaussians, max_gaussians)
    splats, clipped = spz_bytes(up_to_degree(remaining, MOST_DEGREE if sh_degree is None else sh_degree), out)
    bookmarks = evenly_spread(len(result.cameras), MOST_BOOKMARKS)
    parts = {"splats": splats, "mesh": glb, "libraries": LIBRARIES.read_bytes()}
    encoded = {name: b64encode(content).decode() for name, content in parts.items()}
    page = write_page(
        out,
        "share.html",
        package="gsjax.sharing",
        title=source.resolve().name if title is None else title,
        view={**_view(result, bookmarks), "has_mesh": bool(glb)},
        **encoded,
    )
    sizes = {name: len(encoded[name]) for name in ("splats", "mesh")}
    return {
        "gaussians": remaining.num_gaussians,
        "left_out": result.gaussians.num_gaussians - remaining.num_gaussians,
        "bookmarks": len(bookmarks),
        "clipped": clipped,
        **sizes,
        "viewer": page.stat().st_size - sum(sizes.values()),
        "bytes": page.stat().st_size,
    }


def _check(out: Path, max_gaussians: int | None, sh_degree: int | None) -> None:
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"out={out}: a page ends in .html")
    if max_gaussians is not None and max_gaussians < 1:
        raise InputError(f"max_gaussians={max_gaussians} is not 1 or more")
    if sh_degree is not None and not 0 <= sh_degree <= MOST_DEGREE:
        raise InputError(f"sh_degree={sh_degree} is not between 0 and {MOST_DEGREE}")


def _most_visible(gaussians: Gaussians, most: int | None) -> Gaussians:
    """The Gaussians, at most so many, whose opacity times area of the larger two axes is largest; in their order."""
    if most is None or gaussians.num_gaussians <= most:
        return gaussians
    log_scales = np.sort(np.asarray(gaussians.log_scales, np.float64), axis=1)
    cover = np.log(np.maximum(np.asarray(opacities(gaussians)), 1e-12)) + log_scales[:, 1:].sum(axis=1)
    return take(gaussians, np.sort(np.argsort(-cover, kind="stable")[:most]))


def _mesh_bytes(source: Path, mesh: str | Path | None) -> bytes:
    """The mesh as GLB: the given one, else that of a run folder, the textured one where there are two; else empty."""
    own = [source / name for name in ("mesh.glb", "mesh.ply") if source.is_dir() and (source / name).is_file()]
    files = own if mesh is None else [mesh]
    return glb_bytes(files[0]) if files else b""


def _view(result: Result, bookmarks: Sequence[int]) -> dict[str, Any]:
    """What `share.js` reads, in JSON's own types and local coordinates; the page begins at the first bookmark."""

    def bookmark(index: int) -> dict[str, Any]:
        camera = result.cameras[index]
        return {
            "name": result.names[index],
            "viewmat": np.asarray(camera.viewmat, np.float64).T.ravel(),  # by columns, as three.js has it
            "slopes": [camera.width / 2 / camera.K[0, 0], camera.height / 2 / camera.K[1, 1]],
        }

    middle = opaque_middle(result.gaussians)
    first = viewmat_center(np.asarray(result.cameras[bookmarks[0]].viewmat, np.float64))
    return json_files.plain(
        {
            "up": mean_up(result.cameras),
            "middle": middle,
            "scale": float(np.linalg.norm(first - middle)) or 1.0,
            "background": _hex(np.asarray(result.background)),
            "is_mip": result.gaussians.pixel_filter == "mip",
            "similarity": asdict(result.similarity),
            "bookmarks": list(map(bookmark, bookmarks)),
        }
    )


def _hex(background: np.ndarray) -> str:
    """`#rrggbb` of a colour, or of the mean of a background that changes with the direction."""
    color = background if background.ndim == 1 else SH_C0 * background[0] + 0.5
    return "#" + bytes(np.rint(255 * np.clip(color, 0, 1)).astype(np.uint8)).hex()
