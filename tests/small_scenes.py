"""Scenes of a few Gaussians whose depth and normals have a closed form."""

import fcntl
import os
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from gsjax.analytic import solids
from gsjax.gaussians import Gaussians, rgb_to_sh
from gsjax.io import analytic_scene
from gsjax.rendering import gallery
from gsjax.scene import Frame, Pixels, frame_of
from gsjax.scene.cameras import Camera, look_at
from gsjax.training.initialize import DEAD_LOGIT
from gsjax.training.loop import Work, follow
from gsjax.training.plan import check_terms, plan

write_scene = analytic_scene.write_built_in_scene  # Tests may put another function in its place.


def built_in(folder: Path, num_views: int, size: tuple[int, int]) -> Path:
    """The built-in scene, with few samples of its truth and pixels; a session makes it once, in the first worker."""
    original = Path(os.environ["GSJAX_TEST_SCENES"], f"{num_views}_{size[0]}x{size[1]}")
    with original.with_suffix(".lock").open("w") as lock, pytest.MonkeyPatch.context() as patched:
        fcntl.flock(lock, fcntl.LOCK_EX)
        patched.setattr(analytic_scene, "TRUTH_SAMPLES", (6_000, 4_000))
        patched.setattr(solids, "trace", partial(solids.trace, samples=2))
        if not original.exists():
            write_scene(original, num_views=num_views, size=size, progress=partial(tqdm, disable=True))
    return shutil.copytree(original, folder, dirs_exist_ok=True)


def fit(settings, frames, extent, state, optimizer, terms=None, capacity=None, **shared):
    """The state after the phases of the settings; `shared` are fields of `Work`."""
    planned = plan(settings, terms or {})
    check_terms(planned, frames)
    return follow(Work(planned, frames, extent, optimizer, **shared), state, capacity)


def camera_at(eye=(0.0, 0.0, 0.0), target=(0.0, 0.0, 1.0), *, size=(32, 24), focal=30.0) -> Camera:
    """A camera that looks at `target`, its principal point off the middle."""
    viewmat = look_at(np.asarray(eye, np.float64), np.asarray(target, np.float64), np.array([0.0, -1.0, 0.0]))
    width, height = size
    K = np.array([[focal, 0, 0.5 * width + 0.7], [0, 1.1 * focal, 0.5 * height - 0.4], [0, 0, 1]])
    return Camera(jnp.asarray(viewmat, jnp.float32), jnp.asarray(K, jnp.float32), width, height)


def moved(camera: Camera, rotation: np.ndarray, translation: np.ndarray) -> Camera:
    """The camera after the world's points went from p to `rotation` p + `translation`."""
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = rotation, translation
    viewmat = np.asarray(camera.viewmat, np.float64) @ np.linalg.inv(to_world)
    return Camera(jnp.asarray(viewmat, jnp.float32), camera.K, camera.width, camera.height)


def discs(points, normals, radius, *, thickness=0.02, opacity=0.95, colors=None) -> Gaussians:
    """A flat Gaussian a point, `thickness` times as thick as wide, its z axis along the normal."""
    count = len(points)
    normals = np.broadcast_to(normals, (count, 3))
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    x = np.cross(helper, normals)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    axes = np.stack([x, np.cross(normals, x), normals], axis=-1)
    colors = np.full((count, 3), 0.5) if colors is None else colors
    return Gaussians(
        means=jnp.asarray(points, jnp.float32),
        quats=jnp.asarray(Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]], jnp.float32),
        log_scales=jnp.asarray(np.tile(np.log([radius, radius, thickness * radius]), (count, 1)), jnp.float32),
        logit_opacities=jnp.full(count, np.log(opacity / (1 - opacity)), jnp.float32),
        sh_dc=jnp.asarray(rgb_to_sh(colors)[:, None], jnp.float32),
        sh_rest=jnp.zeros((count, 0, 3), jnp.float32),
    )


def one_gaussian(log_scales, *, opacity=0.8, mean=(0.0, 0.0, 0.0)) -> Gaussians:
    """A Gaussian along the world's axes."""
    upright = discs([mean], (0.0, 0.0, 1.0), 1.0, opacity=opacity)
    quats = jnp.asarray([[1.0, 0.0, 0.0, 0.0]])
    return replace(upright, log_scales=jnp.asarray([log_scales], jnp.float32), quats=quats)


def plane(normal, *, distance=4.0, per_side=16, spacing=0.35, **options) -> Gaussians:
    """`per_side` squared discs on the plane through (0, 0, `distance`), a grid in that plane."""
    normal = np.asarray(normal, np.float64) / np.linalg.norm(normal)
    x = np.cross([0.0, 1.0, 0.0], normal)
    x /= np.linalg.norm(x)
    steps = (np.arange(per_side) - 0.5 * (per_side - 1)) * spacing
    u, v = np.meshgrid(steps, steps)
    points = u.reshape(-1, 1) * x + v.reshape(-1, 1) * np.cross(normal, x) + [0, 0, distance]
    return discs(points, normal, options.pop("radius", spacing), **options)


def cloud(count, *, capacity=None, sh_degree=1, seed=0) -> Gaussians:
    """Coloured Gaussians about (0, 0, 4), as large as a few pixels; the rows beyond `count` are dead."""
    rng = np.random.default_rng(seed)
    capacity = count if capacity is None else capacity
    alive = np.arange(capacity) < count
    return Gaussians(
        means=jnp.asarray(rng.uniform([-1.6, -1.2, 3.4], [1.6, 1.2, 4.6], (capacity, 3)), jnp.float32),
        quats=jnp.asarray(rng.normal(size=(capacity, 4)), jnp.float32),
        log_scales=jnp.asarray(np.log(0.25) + 0.3 * rng.normal(size=(capacity, 3)), jnp.float32),
        logit_opacities=jnp.asarray(np.where(alive, rng.normal(size=capacity), DEAD_LOGIT), jnp.float32),
        sh_dc=jnp.asarray(rgb_to_sh(rng.uniform(size=(capacity, 1, 3))), jnp.float32),
        sh_rest=jnp.asarray(0.2 * rng.normal(size=(capacity, (sh_degree + 1) ** 2 - 1, 3)), jnp.float32),
    )


def angles(directions, expected) -> np.ndarray:
    """Degrees between two fields of vectors, sign included."""
    a, b = (np.asarray(x, np.float64) for x in (directions, expected))
    cosine = np.sum(a * b, -1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def photographed(gaussians: Gaussians, cameras: list[Camera], *, with_mattes=False) -> tuple[Frame, ...]:
    """Photos of the Gaussians over black; with mattes, straight colours and coverage."""
    frames = []
    for index, (camera, picture) in enumerate(
        zip(cameras, gallery.pictures(gaussians, cameras, np.zeros(3)), strict=True)
    ):
        colors, matte = picture.colors, None
        if with_mattes:
            colors = colors / np.maximum(picture.alphas, 1e-3)[..., None]
            matte = np.rint(255 * picture.alphas).astype(np.uint8)
        photo = np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8)
        frames.append(frame_of(f"{index}.png", np.asarray(camera.viewmat), np.asarray(camera.K), Pixels(photo, matte)))
    return tuple(frames)
