"""What does the editing example of docs/refinement.md do? Draws mesh and Gaussians of a refined run, before and after.

    python experiments/editing_picture.py --run REFINED --out docs/assets/edited.png

REFINED is a folder that `gsjax refine` made from a scene whose z axis points up.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gsjax.cli import run_guarded

if TYPE_CHECKING:  # They import jax.
    from gsjax.binding.hybrid import Hybrid
    from gsjax.cameras import Camera
    from gsjax.runs.result import Result

TWIST = 1.6  # radians per unit of height
ENLARGED = 2
GAP = 6  # white pixels between the panels


def draw(run: str, out: str, *, view: int) -> None:
    """Writes four panels in a row: mesh and Gaussians as refined, mesh and Gaussians twisted."""
    from gsjax.binding.editing import rebound, with_vertices
    from gsjax.io.images import write_image
    from gsjax.meshing import read_mesh
    from gsjax.runs.result import open_result

    result, mesh = open_result(run), read_mesh(Path(run) / "mesh.ply")
    refined = rebound(mesh, result.gaussians)
    edited = replace(refined, bound=with_vertices(refined.bound, twisted(mesh.vertices)))
    panels = [*_panels(refined, result, view), *_panels(edited, result, view)]
    gap = np.full((panels[0].shape[0], GAP, 3), 255, np.uint8)
    write_image(Path(out), np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1))


def twisted(vertices: np.ndarray) -> np.ndarray:
    """`[V, 3]` vertices turned about the z axis, more the higher they are."""
    x, y, z = vertices.T
    angle = TWIST * np.maximum(z, 0)
    return np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z], axis=-1)


def enlarged(camera: "Camera") -> "Camera":
    """The same view with `ENLARGED` times as many pixels along each side."""
    from gsjax.cameras import Camera

    K = camera.K * np.array([[ENLARGED], [ENLARGED], [1]], np.float32)
    return Camera(camera.viewmat, K, ENLARGED * camera.width, ENLARGED * camera.height)


def _panels(hybrid: "Hybrid", result: "Result", view: int) -> list[np.ndarray]:
    from gsjax.binding.bound import to_mesh
    from gsjax.binding.hybrid import all_gaussians
    from gsjax.colors import to_bytes
    from gsjax.render import gallery
    from gsjax.report.pictures import mesh_picture

    camera = enlarged(result.cameras[view])
    picture = next(gallery.pictures(all_gaussians(hybrid), [camera], result.background))
    return [mesh_picture(to_mesh(hybrid.bound), camera), to_bytes(picture.colors)]


def main() -> None:
    """Reads the arguments and draws."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", required=True, help="folder that `gsjax refine` made")
    parser.add_argument("--out", required=True, help="the picture (.png)")
    parser.add_argument("--view", type=int, default=8, help="index of the view to draw (default: 8)")
    arguments = parser.parse_args()
    draw(arguments.run, arguments.out, view=arguments.view)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
