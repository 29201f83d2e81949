"""How do runs look beside each other in one held-out view: render, normals of the depth, mesh?

    python experiments/side_by_side.py RUN ... --out FILE [--view N]

All runs are of one data set; photo and truth, as far as the data set knows it, are the first column.
"""

import argparse
import re
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gsjax.cli import run_guarded
from gsjax.errors import InputError
from gsjax.report.panels import draw_panels
from gsjax.scene import Frame, Truth

if TYPE_CHECKING:  # It imports jax.
    from gsjax.cameras import Camera

COLUMNS = 6
TITLE = 24  # characters a line


def draw(sources: Sequence[str], out: str, *, view: int = 0) -> list[str]:
    """Draws the picture, and tells the titles of its panels: the photo, then the runs without their seeds.

    Args:
        sources: Run folders of one data set and one size; those without a `mesh.ply` have no mesh in the picture, which
            has no row of meshes where none has one.
        out: The picture, a .png or .jpg.
        view: Of the held-out ones.

    Raises:
        InputError: A run cannot be read or has no such view, or two are seeds of one variant.
    """
    from gsjax.cameras import Camera
    from gsjax.runs.result import scene_of_run

    scene = scene_of_run(Path(sources[0]))
    if not 0 <= view < len(scene.held_out_frames):
        raise InputError(f"{sources[0]}: holds out {len(scene.held_out_frames)} views; there is no view {view}")
    frame = scene.held_out_frames[view]
    camera = Camera(frame.viewmat, frame.K, frame.width, frame.height)  # pyright: ignore[reportArgumentType]
    panels = {"photo" if scene.truth is None else "photo and truth": _true(frame, camera, scene.truth)}
    for source in sources:
        title = textwrap.fill(re.sub(r"_\d+$", "", Path(source).name), TITLE)
        if title in panels:
            raise InputError(f"{source}: another run has this name; seeds of one variant would look alike")
        panels[title] = _made(source, frame.name)
    rows = slice(None) if any(_mesh(source).exists() for source in sources) else slice(-1)
    stacked = {title: np.concatenate(pictures[rows]) for title, pictures in panels.items()}
    draw_panels(stacked, out, columns=min(COLUMNS, len(panels)))
    return list(panels)


def _true(frame: Frame, camera: "Camera", truth: Truth | None) -> list[np.ndarray]:
    from gsjax.meshing import read_mesh
    from gsjax.report.pictures import mesh_picture, normal_picture

    image = frame.pixels().image
    normals = mesh = np.full_like(image, 255)
    if truth is not None and frame.name in truth.normals:
        normals = normal_picture(truth.normals[frame.name]())
    if truth is not None and truth.mesh is not None:
        mesh = mesh_picture(read_mesh(truth.mesh), camera)
    return [image, normals, mesh]


def _made(run: str, name: str) -> list[np.ndarray]:
    from gsjax.meshing import read_mesh
    from gsjax.render import gallery
    from gsjax.report.pictures import mesh_picture, surface_picture, to_bytes
    from gsjax.runs.result import open_result

    result = open_result(run)
    if name not in result.names:
        raise InputError(f"{run}: has no view {name}; are these runs of one data set?")
    camera = result.cameras[result.names.index(name)]
    picture = next(gallery.pictures(result.gaussians, [camera], result.background, result.depth_mode))
    colors, surface = to_bytes(picture.colors), surface_picture(picture.depth, camera)
    mesh = _mesh(run)
    meshed = mesh_picture(read_mesh(mesh), camera) if mesh.exists() else np.full_like(colors, 255)
    return [colors, surface, meshed]


def _mesh(run: str) -> Path:
    return Path(run) / "mesh.ply"


def main() -> None:
    """Reads the arguments and names what was drawn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", metavar="RUN", help="folders of runs of one data set")
    parser.add_argument("--out", required=True, metavar="FILE", help="the picture (.png, .jpg)")
    parser.add_argument("--view", type=int, default=0, metavar="N", help="of the held-out ones (default: 0)")
    arguments = parser.parse_args()
    draw(arguments.runs, arguments.out, view=arguments.view)
    print(arguments.out)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
