"""The shared page: a viewer, Gaussians, cameras and a mesh in one HTML file.

The viewer is `templates/share.js`. It draws by Spark and three.js, which `vendor/libraries.min.js.gz` holds.
"""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.gaussians import SH_C0, Gaussians
from gsjax.io import json_files
from gsjax.io.files import atomic_path
from gsjax.io.packages import require
from gsjax.io.spz import spz_bytes
from gsjax.scene.cameras import Camera, viewmat_center
from gsjax.scene.similarity import Similarity

LIBRARIES = Path(__file__).parent / "vendor" / "libraries.min.js.gz"


@dataclass(frozen=True)
class Shared:
    """What a page shows; all but the mesh in local coordinates."""

    title: str
    gaussians: Gaussians  # numpy, harmonics of degree 3 at most
    bookmarks: Sequence[tuple[str, Camera]]  # names and cameras; the page begins at the first
    middle: np.ndarray  # [3]: what the page turns around
    up: np.ndarray  # [3] unit
    background: np.ndarray  # [3] or SH, see `gsjax.rendering.backdrop`
    similarity: Similarity  # to local coordinates from those of the mesh and of saved paths
    glb: bytes | None = None  # the mesh


def write_shared(path: str | Path, shared: Shared) -> dict[str, int]:
    """Writes the page; whatever it is given is escaped.

    Returns:
        `clipped`: how many Gaussians hold values that SPZ cannot reach. Bytes within the page, each a third larger than
        by itself: `splats`, `mesh` and `viewer`; and of all of it: `bytes`.

    Raises:
        InputError: The Gaussians hold what SPZ cannot, or the file cannot be written.
    """
    splats, clipped = spz_bytes(shared.gaussians, path)
    parts = {"splats": splats, "mesh": shared.glb or b"", "libraries": LIBRARIES.read_bytes()}
    encoded = {name: b64encode(content).decode() for name, content in parts.items()}
    jinja2 = require("jinja2")
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("gsjax.sharing"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("share.html").render(title=shared.title, view=_view(shared), **encoded)
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace")  # Names may hold bytes of Latin-1.
    return {
        "clipped": clipped,
        "splats": len(encoded["splats"]),
        "mesh": len(encoded["mesh"]),
        "viewer": len(page) - len(encoded["splats"]) - len(encoded["mesh"]),
        "bytes": Path(path).stat().st_size,
    }


def _view(shared: Shared) -> Any:
    """What `share.js` reads, in JSON's own types."""
    viewmats = np.stack([np.asarray(camera.viewmat, np.float64) for _, camera in shared.bookmarks])
    return json_files.plain(
        {
            "up": shared.up,
            "middle": shared.middle,
            "scale": float(np.linalg.norm(viewmat_center(viewmats[0]) - shared.middle)) or 1.0,
            "background": _hex(shared.background),
            "is_mip": shared.gaussians.pixel_filter == "mip",
            "has_mesh": shared.glb is not None,
            "similarity": asdict(shared.similarity),
            "bookmarks": [
                {
                    "name": name,
                    "viewmat": viewmat.T.ravel(),  # by columns, as three.js has it
                    "slopes": [camera.width / 2 / camera.K[0, 0], camera.height / 2 / camera.K[1, 1]],
                }
                for viewmat, (name, camera) in zip(viewmats, shared.bookmarks, strict=True)
            ],
        }
    )


def _hex(background: np.ndarray) -> str:
    """`#rrggbb` of a colour, or of the mean of a background that changes with the direction."""
    color = background if background.ndim == 1 else SH_C0 * background[0] + 0.5
    return "#" + bytes(np.rint(255 * np.clip(color, 0, 1)).astype(np.uint8)).hex()
