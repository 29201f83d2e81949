"""The analytic scene as a data set: photos, exact depth and normals, a COLMAP model, surface samples and a mesh.

Truth has the layout of `gsjax.io.truth`, with labels 1 to 5 of the solids, and albedo as the mesh's colours. Photos are
sRGB before white. `sparse/0` is binary: one PINHOLE camera, true poses, noisy surface points with tracks. `scene.json`
holds the numbers.
"""

import json
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from PIL import Image
from tqdm import tqdm

from gsjax.analytic import solids, true_surface
from gsjax.io import ply
from gsjax.io.colmap_writer import pinhole_camera
from gsjax.io.files import atomic_folder
from gsjax.io.packages import require
from gsjax.scene.cameras import Camera, project, rotation, world_to_camera
from gsjax.scene.colors import linear_to_srgb, to_bytes
from gsjax.scene.meshes import Mesh

HELD_OUT_EVERY = 8  # views 0, 8, 16, ... are for scoring
MESH_SPACING = 0.02  # world units
SPARSE_POINTS = (1200, 800)  # on the solids, on the table
POINT_NOISE = 0.004  # world units, as bundle adjustment leaves
PIXEL_NOISE = 0.25
LONGEST_TRACK = 10
TRUTH_SAMPLES = (24_000, 16_000)  # on the solids, on the table
TRUTH_VIEWS = 3  # training views that must see a sample
TRUTH_HALF = 1.1  # The table counts as truth where |x| and |y| are below this, world units: a box, as scores are taken.


class _Samples(NamedTuple):
    """Points of the surface, spread evenly, in random order."""

    points: np.ndarray  # [P, 3] float32 world
    normals: np.ndarray  # [P, 3] float32 unit, world
    on_table: np.ndarray  # [P] bool, else on a solid
    visible: np.ndarray  # [V, P] bool by view


def write_built_in_scene(
    out: str | Path,
    *,
    num_views: int = 40,
    size: tuple[int, int] = (160, 160),
    seed: int = 0,
    progress: Callable[..., tqdm] = tqdm,
) -> Path:
    """Render the built-in scene into a folder, which appears when everything is done, and return the folder.

    Args:
        out: Folder to make. Must not exist, or be empty: else InputError.
        num_views: Photos.
        size: (width, height) in pixels.
        seed: Of cameras, samples and noise.
        progress: Makes a progress bar, called with tqdm's `total`, `desc` and `unit`.
    """
    with atomic_folder(out) as folder:
        for part in ("images", "depth", "normals", "sparse/0"):
            (folder / part).mkdir(parents=True)
        cameras = solids.cameras(num_views, size, seed=seed)

        def write_view(index: int) -> None:
            _write_view(folder, f"{index:03d}", cameras[index], solids.trace(cameras[index]))

        with (
            progress(total=num_views, desc="analytic scene", unit="view") as bar,
            ThreadPoolExecutor(os.cpu_count()) as pool,  # A view is many small programs, which leave cores idle.
        ):
            write_view(0)  # Alone: views at once would each compile them.
            bar.update()
            for _ in pool.map(write_view, range(1, num_views)):
                bar.update()
        surface = true_surface.mesh(MESH_SPACING)
        (folder / "gt_mesh.ply").write_bytes(ply.encode_mesh(surface))
        samples = _seen_samples(surface, cameras, seed)
        np.savez_compressed(folder / "gt_points.npz", **_truth_points(samples))
        _write_model(folder / "sparse/0", samples, cameras, seed)
        numbers = {
            "views": num_views,
            "test": list(range(0, num_views, HELD_OUT_EVERY)),
            "K": [float(cameras[0].K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))],
            "res": list(size),
            "seed": seed,
            "sky_rgb": [255, 255, 255],
            "table_radius": solids.TABLE_RADIUS,
            "eval_half": TRUTH_HALF,
            "point_noise": POINT_NOISE,
            "pixel_noise": PIXEL_NOISE,
        }
        (folder / "scene.json").write_text(json.dumps(numbers, indent=1) + "\n")
    return Path(out)


def _write_view(folder: Path, name: str, camera: Camera, view: solids.Trace) -> None:
    Image.fromarray(to_bytes(view.colors)).save(folder / "images" / f"{name}.png")
    np.savez_compressed(folder / "depth" / f"{name}.npz", depth=view.depth, label=view.labels)
    normals, turn = np.asarray(view.normals), np.asarray(rotation(camera))
    np.savez_compressed(
        folder / "normals" / f"{name}.npz", cam=normals.astype(np.float16), world=(normals @ turn).astype(np.float16)
    )


def _seen_samples(surface: Mesh, cameras: list[Camera], seed: int) -> _Samples:
    """Three times as many as the truth needs: the table reaches beyond it, and views miss some."""
    num_solids, num_table = (3 * count for count in TRUTH_SAMPLES)
    points, normals, on_table = true_surface.sample_points(surface, num_solids, num_table, seed)
    visible = np.stack([np.asarray(_visible_all(points, camera)) for camera in cameras])
    return _Samples(points, normals, on_table, visible)


def _truth_points(samples: _Samples) -> dict[str, np.ndarray]:
    """Surface samples that enough training views see (all of these, where there are fewer)."""
    training = np.arange(len(samples.visible)) % HELD_OUT_EVERY != 0
    views = samples.visible[training].sum(axis=0)
    usable = views >= min(TRUTH_VIEWS, training.sum())
    usable &= ~samples.on_table | (np.abs(samples.points[:, :2]).max(axis=1) < TRUTH_HALF)
    indices = _first_of_each(usable, samples.on_table, TRUTH_SAMPLES)
    return {
        "points": samples.points[indices],
        "normals": samples.normals[indices].astype(np.float16),
        "label": samples.on_table[indices].astype(np.uint8),
        "n_train_views": np.minimum(views[indices], 255).astype(np.uint8),
    }


def _first_of_each(usable: np.ndarray, on_table: np.ndarray, counts: tuple[int, int]) -> np.ndarray:
    """Indices of so many usable samples on the solids, then on the table."""
    parts = (np.flatnonzero(usable & ~on_table), np.flatnonzero(usable & on_table))
    return np.concatenate([part[:count] for part, count in zip(parts, counts, strict=True)])


def _write_model(folder: Path, samples: _Samples, cameras: list[Camera], seed: int) -> None:
    """Poses, and noisy points with the pixels of the views that see them, as structure from motion leaves them."""
    pycolmap = require("pycolmap")
    rng = np.random.default_rng(seed)
    indices = _first_of_each(samples.visible.sum(axis=0) >= 2, samples.on_table, SPARSE_POINTS)
    points, visible = samples.points[indices], _limited(samples.visible[:, indices], rng)
    pixels = np.stack([np.asarray(_project_all(points, camera)) for camera in cameras])
    pixels += rng.normal(0, PIXEL_NOISE, pixels.shape).astype(np.float32)
    colors = to_bytes(linear_to_srgb(solids.in_blocks(solids.shade_all, points)))

    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pinhole_camera(1, cameras[0]))
    tracks = [[] for _ in points]
    for index, camera in enumerate(cameras):
        observed = np.flatnonzero(visible[index])
        for order, point in enumerate(observed):
            tracks[point].append(pycolmap.TrackElement(index + 1, order))
        image = pycolmap.Image(f"{index:03d}.png", pixels[index, observed].astype(np.float64), 1, index + 1)
        pose = np.asarray(camera.viewmat, np.float64)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3]))
    noisy = points + rng.normal(0, POINT_NOISE, points.shape)
    for position, track, color in zip(noisy, tracks, colors, strict=True):
        model.add_point3D(position, pycolmap.Track(track), color)
    model.update_point_3d_errors()
    model.write_binary(folder)


def _limited(visible: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """`[V, P]` bool with at most LONGEST_TRACK views, drawn at random, for every point."""
    rank = np.argsort(np.argsort(np.where(visible, rng.random(visible.shape), 2.0), axis=0), axis=0)
    return visible & (rank < LONGEST_TRACK)


_visible_all = jax.jit(jax.vmap(solids.visible, in_axes=(0, None)))
_project_all = jax.jit(jax.vmap(lambda point, camera: project(world_to_camera(point, camera), camera), (0, None)))
