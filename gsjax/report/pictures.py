"""Arrays of colours, depths and normals as pictures of bytes, and several pictures as one file."""

import math
from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gsjax.cameras import Camera
from gsjax.io.files import atomic_path
from gsjax.mesh import Mesh
from gsjax.meshing.pictures import Shading, headlight, render_mesh
from gsjax.normals.from_depth import depth_normals


def to_bytes(image: np.ndarray) -> np.ndarray:
    """0..1 to uint8, rounded."""
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)


def depth_picture(depth: np.ndarray) -> np.ndarray:
    """`[H, W, 3]` uint8 grey: near is light, far is dark, nothing is black."""
    seen = depth > 0
    if not seen.any():
        return np.zeros((*depth.shape, 3), np.uint8)
    near, far = np.quantile(depth[seen], [0.01, 0.99])
    grey = np.where(seen, 1 - 0.85 * np.clip((depth - near) / max(far - near, 1e-6), 0, 1), 0)
    return to_bytes(np.repeat(grey[..., None], 3, -1))


def normal_picture(normals: np.ndarray) -> np.ndarray:
    """`[H, W, 3]` uint8: x to the right red, y up green, towards the camera blue; white where there is none."""
    known = np.any(normals != 0, axis=-1, keepdims=True)
    return to_bytes(np.where(known, 0.5 + 0.5 * normals * np.array([1, -1, -1]), 1))


def surface_picture(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """`normal_picture` of the surface that a rendered depth `[H, W]` implies."""
    return normal_picture(np.asarray(depth_normals(jnp.asarray(depth), camera)))


def mesh_picture(mesh: Mesh, camera: Camera, shading: Shading = headlight) -> np.ndarray:
    """`[H, W, 3]` uint8: a mesh as `camera` sees it."""
    return render_mesh(mesh, camera.viewmat, camera.K, camera.width, camera.height, shading=shading)


def draw_panels(panels: Mapping[str, np.ndarray], path: str | Path, *, columns: int = 4) -> Path:
    """Write pictures `[H, W, 3]` uint8 under their titles, in rows of `columns`.

    Raises:
        InputError: The file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = math.ceil(len(panels) / columns)
    height, width = next(iter(panels.values())).shape[:2]
    figure = Figure(figsize=(13, (13 / columns * height / width + 0.4) * rows), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (title, image) in zip(figure.subplots(rows, columns, squeeze=False).flat, panels.items(), strict=False):
        axes.imshow(image, interpolation="nearest")
        axes.set_title(title, fontsize=11)
    for axes in figure.axes:
        axes.axis("off")
    with atomic_path(path) as temporary:
        # Of JPEG alone: normals are read by their hue, which subsampling blurs.
        figure.savefig(temporary, dpi=110, pil_kwargs={"quality": 85, "subsampling": 0})
    return Path(path)
