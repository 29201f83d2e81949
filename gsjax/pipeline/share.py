"""A run or a file of Gaussians as one page that opens anywhere.

The viewer is `gsjax/sharing/templates/share.js`. It draws by Spark and three.js, which `vendor/libraries.min.js.gz` in
`gsjax/sharing` holds.
"""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import asdict, replace
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
from gsjax.report.page import write_page
from gsjax.runs.outputs import require_apart
from gsjax.runs.result import Result, open_result
from gsjax.runs.viewpoints import evenly_spread, mean_up, opaque_middle
from gsjax.scene.cameras import Camera, viewmat_center

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
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"out={out}: a page ends in .html")
    if max_gaussians is not None and max_gaussians < 1:
        raise InputError(f"max_gaussians={max_gaussians} is not 1 or more")
    if sh_degree is not None and not 0 <= sh_degree <= MOST_DEGREE:
        raise InputError(f"sh_degree={sh_degree} is not between 0 and {MOST_DEGREE}")
    require_apart(out, source, mesh)
    sweep_beside(out)
    mesh_file = _mesh_of(source) if mesh is None else Path(mesh)
    glb = b"" if mesh_file is None else glb_bytes(mesh_file)
    result = open_result(source)
    if not result.gaussians.num_gaussians:
        raise InputError(f"{source}: holds no Gaussians, there is nothing to show")
    remaining = _most_visible(result.gaussians, max_gaussians)
    bands = ((MOST_DEGREE if sh_degree is None else sh_degree) + 1) ** 2 - 1
    splats, clipped = spz_bytes(replace(remaining, sh_rest=remaining.sh_rest[:, :bands]), out)
    bookmarks = [
        (result.names[index], result.cameras[index]) for index in evenly_spread(len(result.cameras), MOST_BOOKMARKS)
    ]
    parts = {"splats": splats, "mesh": glb, "libraries": LIBRARIES.read_bytes()}
    encoded = {name: b64encode(content).decode() for name, content in parts.items()}
    write_page(
        out,
        "share.html",
        package="gsjax.sharing",
        title=source.resolve().name if title is None else title,
        view={**_view(result, bookmarks), "has_mesh": bool(glb)},
        **encoded,
    )
    page_bytes, splat_bytes, mesh_bytes = out.stat().st_size, len(encoded["splats"]), len(encoded["mesh"])
    return {
        "gaussians": remaining.num_gaussians,
        "left_out": result.gaussians.num_gaussians - remaining.num_gaussians,
        "bookmarks": len(bookmarks),
        "clipped": clipped,
        "splats": splat_bytes,
        "mesh": mesh_bytes,
        "viewer": page_bytes - splat_bytes - mesh_bytes,
        "bytes": page_bytes,
    }


def _most_visible(gaussians: Gaussians, most: int | None) -> Gaussians:
    """The Gaussians, at most so many, whose opacity times area of the larger two axes is largest; in their order."""
    if most is None or gaussians.num_gaussians <= most:
        return gaussians
    log_scales = np.sort(np.asarray(gaussians.log_scales, np.float64), axis=1)
    cover = np.log(np.maximum(np.asarray(opacities(gaussians)), 1e-12)) + log_scales[:, 1:].sum(axis=1)
    return take(gaussians, np.sort(np.argsort(-cover, kind="stable")[:most]))


def _mesh_of(source: Path) -> Path | None:
    """The mesh that a run folder holds, the textured one where there are two."""
    files = [source / name for name in ("mesh.glb", "mesh.ply") if source.is_dir() and (source / name).is_file()]
    return files[0] if files else None


def _view(result: Result, bookmarks: Sequence[tuple[str, Camera]]) -> dict[str, Any]:
    """What `share.js` reads, in JSON's own types and local coordinates; the page begins at the first bookmark."""
    viewmats = np.stack([np.asarray(camera.viewmat, np.float64) for _, camera in bookmarks])
    middle = opaque_middle(result.gaussians)
    return json_files.plain(
        {
            "up": mean_up(result.cameras),
            "middle": middle,
            "scale": float(np.linalg.norm(viewmat_center(viewmats[0]) - middle)) or 1.0,
            "background": _hex(np.asarray(result.background)),
            "is_mip": result.gaussians.pixel_filter == "mip",
            "similarity": asdict(result.similarity),
            "bookmarks": [
                {
                    "name": name,
                    "viewmat": viewmat.T.ravel(),  # by columns, as three.js has it
                    "slopes": [camera.width / 2 / camera.K[0, 0], camera.height / 2 / camera.K[1, 1]],
                }
                for viewmat, (name, camera) in zip(viewmats, bookmarks, strict=True)
            ],
        }
    )


def _hex(background: np.ndarray) -> str:
    """`#rrggbb` of a colour, or of the mean of a background that changes with the direction."""
    color = background if background.ndim == 1 else SH_C0 * background[0] + 0.5
    return "#" + bytes(np.rint(255 * np.clip(color, 0, 1)).astype(np.uint8)).hex()
