"""Pictures of a run: colour, depth and normals of its views or from a circle around the scene."""

from pathlib import Path
from typing import Literal

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from gsjax import gallery
from gsjax.cameras import Camera, look_at
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, opacities
from gsjax.io.files import make_folder
from gsjax.io.images import write_image
from gsjax.mesh import Mesh
from gsjax.meshing.pictures import Shading, headlight, render_mesh
from gsjax.normals.from_depth import depth_normals
from gsjax.pipeline.result import Result, open_result

TURNTABLE_VIEWS = 36


def render(run: str | Path, out: str | Path, *, which: Literal["all", "held_out", "turntable"] = "all") -> Path:
    """Write NAME_color.png, NAME_depth.png and NAME_normal.png for each chosen view.

    Args:
        run: Run folder, or a file of Gaussians.
        out: Folder for the pictures.
        which: Every view of the run, the held-out ones, or a circle around the scene.

    Returns:
        `out`.

    Raises:
        InputError: The run cannot be read or the pictures cannot be written.
    """
    result = open_result(run)
    if which == "turntable":
        cameras = turntable(result)
        names = [f"turn_{i:03d}" for i in range(len(cameras))]
    else:
        chosen = [i for i, held_out in enumerate(result.held_out) if held_out or which == "all"]
        if not chosen:
            raise InputError(f"{run}: has no held-out views to render")
        cameras, names = [result.cameras[i] for i in chosen], [result.names[i] for i in chosen]
    out = make_folder(out)
    shown = gallery.pictures(result.gaussians, cameras, result.background, result.depth_mode)
    for name, camera, picture in tqdm(
        zip(names, cameras, shown, strict=True), total=len(cameras), desc="render", unit="view"
    ):
        stem = Path(name).with_suffix("").as_posix().replace("/", "_")
        write_image(out / f"{stem}_color.png", to_bytes(picture.colors))
        write_image(out / f"{stem}_depth.png", depth_picture(picture.depth))
        write_image(out / f"{stem}_normal.png", surface_picture(picture.depth, camera))
    return out


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


def turntable(result: Result) -> list[Camera]:
    """A circle of cameras at the mean height and distance of the run's own, around the middle of the opaque part."""
    middle = opaque_middle(result.gaussians)
    views = np.stack([np.asarray(c.viewmat) for c in result.cameras])
    centers = -np.einsum("vji,vj->vi", views[:, :3, :3], views[:, :3, 3])
    up = -views[:, 1, :3].mean(0)
    up /= np.linalg.norm(up)
    offsets = centers - middle
    height = float((offsets @ up).mean())
    flat = offsets - (offsets @ up)[:, None] * up
    radius = float(np.linalg.norm(flat, axis=1).mean())
    first = flat[0] / np.linalg.norm(flat[0])
    second = np.cross(up, first)
    angles = 2 * np.pi * np.arange(TURNTABLE_VIEWS) / TURNTABLE_VIEWS
    like = result.cameras[0]
    return [
        Camera(
            look_at(middle + height * up + radius * (np.cos(a) * first + np.sin(a) * second), middle, up),
            like.K,
            like.width,
            like.height,
        )  # pyright: ignore[reportArgumentType]
        for a in angles
    ]


def opaque_middle(gaussians: Gaussians) -> np.ndarray:
    """`[3]` median of the opaque Gaussians' means, or of all where none is; world."""
    opaque = np.asarray(opacities(gaussians)) > 0.5
    means = np.asarray(gaussians.means)
    return np.median(means[opaque] if opaque.any() else means, axis=0)
