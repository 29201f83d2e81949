"""Scenes for the tests of the rasterizer, and the two things done with them: render and differentiate."""

from dataclasses import dataclass, field, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import rasterizer
from rasterizer import GSPLAT, Front, TileGrid, default_tile_size, project
from rasterizer._reference import composite
from rasterizer.features import center_channels


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Scene:
    """Every array that `rasterization` differentiates, and the image size."""

    means: jax.Array
    quats: jax.Array
    scales: jax.Array
    opacities: jax.Array
    colors: jax.Array
    viewmats: jax.Array
    Ks: jax.Array
    backgrounds: jax.Array
    width: int = field(metadata={"static": True})
    height: int = field(metadata={"static": True})


# The native loops are the CPU's; with GSJAX_TEST_GPU=1 the tests may run elsewhere.
BACKENDS = ("reference", *(["native"] if jax.default_backend() == "cpu" else []), "xla", "pallas")
OWN = "native" if "native" in BACKENDS else "pallas"  # the backend that this device takes by itself
GAUSSIAN_FIELDS = ("means", "quats", "scales", "opacities", "colors")
FIELDS = (*GAUSSIAN_FIELDS, "viewmats", "Ks", "backgrounds")


def camera_at(x=0.0, y=0.0, z=0.0, yaw=0.0):
    """`[4, 4]` world to camera of a camera at a place, turned about its y axis by `yaw` radians."""
    c, s = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ [x, y, z]
    return viewmat


def intrinsics(width, height, fx=None, fy=None):
    """`[3, 3]` pinhole with a principal point off the middle and fx != fy."""
    fx = 0.9 * max(width, height) if fx is None else fx
    fy = 1.1 * fx if fy is None else fy
    return np.array([[fx, 0, 0.48 * width], [0, fy, 0.53 * height], [0, 0, 1.0]])


def make(width, height, **arrays):
    """A scene from anything array-like."""
    return Scene(width=width, height=height, **{k: jnp.asarray(np.asarray(v), np.float32) for k, v in arrays.items()})


def cloud(count=40, *, cameras=1, channels=3, sh_degree=None, size=(37, 29), seed=0):
    """Random Gaussians in front of one or more cameras, some of them off the image."""
    rng = np.random.default_rng(seed)
    width, height = size
    color_shape = (count, channels) if sh_degree is None else (count, (sh_degree + 1) ** 2, channels)
    return make(
        width,
        height,
        means=rng.uniform([-2.0, -1.5, 1.5], [2.0, 1.5, 4.0], (count, 3)),
        quats=rng.normal(size=(count, 4)),
        scales=np.exp(rng.uniform(np.log(0.02), np.log(0.3), (count, 3))),
        opacities=rng.uniform(0.1, 1.0, count),
        colors=rng.uniform(0, 1, color_shape) if sh_degree is None else rng.normal(size=color_shape) * 0.4,
        viewmats=np.stack([camera_at(0.2 * c, 0.1 * c, 0, -0.08 * c) for c in range(cameras)]),
        Ks=np.stack([intrinsics(width, height)] * cameras),
        backgrounds=rng.uniform(0, 1, (cameras, channels)),
    )


def smooth():
    """Four overlapping splats, distinct depths, no alpha near the clamp: differentiable under `NO_THRESHOLDS`."""
    return make(
        6,
        5,
        means=[[-0.3, 0.1, 2.0], [0.4, -0.2, 2.5], [0.05, 0.3, 3.1], [0.1, -0.35, 3.9]],
        quats=[[1, 0.2, -0.3, 0.1], [0.4, 1, 0.2, -0.5], [0.9, -0.1, 0.4, 0.6], [0.3, 0.7, -0.8, 0.2]],
        scales=[[0.5, 0.3, 0.2], [0.25, 0.6, 0.4], [0.7, 0.35, 0.5], [0.6, 0.8, 0.3]],
        opacities=[0.6, 0.45, 0.7, 0.8],
        colors=[[0.9, 0.1], [0.2, 0.8], [0.5, 0.4], [0.3, 0.7]],
        viewmats=[camera_at(0.05, -0.04, 0.1, 0.07)],
        Ks=[intrinsics(6, 5, fx=6.0)],
        backgrounds=[[0.25, 0.6]],
    )


NO_THRESHOLDS = rasterizer.Rules(
    alpha_max=1.0, alpha_min=0.0, transmittance_min=-1.0, extent_sigmas=1e3, opacity_extent=False
)


def single(
    mean=(0.0, 0.0, 2.0),
    scale=(0.1, 0.1, 0.1),
    quat=(1.0, 0, 0, 0),
    opacity=0.8,
    *,
    size=16,
    focal=16.0,
    dtype=np.float32,
):
    """One red-green Gaussian before a camera in the origin that looks along +z, principal point in the middle."""
    return make(
        size,
        size,
        means=[mean],
        quats=[quat],
        scales=[scale],
        opacities=[opacity],
        colors=[[0.75, 0.25]],
        viewmats=[np.eye(4)],
        Ks=[[[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]]],
        backgrounds=np.zeros((1, 2)),
    )


def stacks(*, count=40, size=(37, 29)):
    """Opaque splats in piles that cover the image: most pixels stop early, each at another depth."""
    rng = np.random.default_rng(7)
    scene = cloud(count, size=size, seed=8)
    return replace(
        scene,
        scales=jnp.asarray(rng.uniform(0.3, 0.9, (count, 3)), np.float32),
        opacities=jnp.asarray(rng.uniform(0.8, 0.97, count), np.float32),
    )


def with_odd_one(scene, **fields):
    """The scene with the given fields of its last Gaussian replaced: no new shape, no new compilation."""
    rows = {name: getattr(scene, name).at[-1].set(jnp.asarray(value, jnp.float32)) for name, value in fields.items()}
    return replace(scene, **rows)


def in_float64(scene):
    """The same numbers in float64; call it under `jax.enable_x64(True)`."""
    return jax.tree.map(lambda x: jnp.asarray(np.asarray(x), np.float64), scene)


def render(scene, **options):
    """`rasterizer.rasterization` of a scene."""
    s = scene
    return rasterizer.rasterization(
        s.means, s.quats, s.scales, s.opacities, s.colors, s.viewmats, s.Ks, s.width, s.height,
        **{"backgrounds": s.backgrounds, **options},
    )  # fmt: skip


def binned(scene, side, *, backend="auto", capacity=4096, masks=None, **options):
    """A scene's splats, the tiles of its cameras, and the splats' lists."""
    s = scene
    projection = project(s.means, s.quats, s.scales, s.opacities, s.viewmats, s.Ks, s.width, s.height, **options)
    grid = TileGrid(s.viewmats.shape[0], s.width, s.height, side)
    how = {"backend": backend}
    return projection, grid, rasterizer.bin_splats(projection, s.opacities, grid, capacity, GSPLAT, masks, **how)


def loss(scene, **options):
    """`(loss, (image, alphas, info))`: image and alphas summed with fixed random weights."""
    image, alphas, info = render(scene, **options)
    rng = np.random.default_rng(3)
    w_image, w_alpha = (jnp.asarray(rng.normal(size=x.shape), x.dtype) for x in (image, alphas))
    return jnp.sum(w_image * image) + jnp.sum(w_alpha * alphas), (image, alphas, info)


@partial(
    jax.jit,
    static_argnames=(
        "backend",
        "capacity",
        "render_mode",
        "sh_degree",
        "rules",
        "near_plane",
        "rasterize_mode",
        "depth_mode",
        "camera_model",
        "tile_size",
    ),
)
def evaluate(scene, backend, capacity=2048, **options):
    """`(image, alphas, info, gradient of loss)`: one program, and so one compilation, per shape and backend."""
    value_and_grad = jax.value_and_grad(loss, has_aux=True)
    (_, (image, alphas, info)), gradient = value_and_grad(scene, backend=backend, capacity=capacity, **options)
    return image, alphas, info, gradient


def loss_in_front(scene, backend, capacity):
    """`loss` of the default depth of training: planes of the first layers, and what they cover, down to a fifth."""
    s, size = scene, (scene.width, scene.height)
    projection = project(s.means, s.quats, s.scales, s.opacities, s.viewmats, s.Ks, *size, depth_mode="plane")
    covers = projection.visible[..., None].astype(projection.depths.dtype)
    if backend == "reference":  # It evaluates the plane of its last feature at every pixel itself.
        features = jnp.concatenate([covers, center_channels(projection)], -1)
        image, left, _ = composite(projection, s.opacities[None], features, *size, GSPLAT, Front(2, 0.2))
        depth, covered = image[..., 1:], image[..., :1]
    else:
        side = default_tile_size(backend)
        _, grid, pairs = binned(s, side, backend=backend, capacity=capacity, depth_mode="plane")
        features = jnp.concatenate([rasterizer.depth_channels(projection, *size), covers], -1)
        image, left, _ = rasterizer.blend(
            projection, s.opacities, features, pairs, grid, backend=backend, front=Front(4, 0.2)
        )
        depth, covered = rasterizer.blended_depth(image[..., :3]), image[..., 3:]
    image = jnp.concatenate([depth, covered], -1)
    rng = np.random.default_rng(3)
    w_image, w_alpha = (jnp.asarray(rng.normal(size=x.shape), x.dtype) for x in (image, left))
    return jnp.sum(w_image * image) + jnp.sum(w_alpha * left), (image, 1 - left)


@partial(jax.jit, static_argnames=("backend", "capacity"))
def evaluate_in_front(scene, backend, capacity=2048):
    """As `evaluate`, of depth in front."""
    (_, outputs), gradient = jax.value_and_grad(loss_in_front, has_aux=True)(scene, backend, capacity)
    return *outputs, {}, gradient


def textbook(scene):
    """Float64 numpy: pixels `[N, 2]`, z `[N]`, and covariances `[N, 3, 3]` of (u, v, z) in a scene's first camera.

    From the textbook's matrices, the camera linearised at each mean, or at most 15 % of the image outside of it.
    """
    viewmat, K = np.asarray(scene.viewmats[0], np.float64), np.asarray(scene.Ks[0], np.float64)
    size, focal, middle = np.array([scene.width, scene.height]), np.diag(K)[:2], K[:2, 2]
    rotations = Rotation.from_quat(np.asarray(scene.quats, np.float64)[:, [1, 2, 3, 0]]).as_matrix()
    means2d, depths, covariances = [], [], []
    for mean, axes, scales in zip(scene.means, rotations, scene.scales, strict=True):
        point = viewmat[:3, :3] @ np.asarray(mean, np.float64) + viewmat[:3, 3]
        margin = 0.15 * size / focal
        slope = np.clip(point[:2] / point[2], -middle / focal - margin, (size - middle) / focal + margin)
        J = np.zeros((3, 3))
        J[[0, 1], [0, 1]], J[:2, 2], J[2, 2] = focal / point[2], -focal * slope / point[2], 1
        M = J @ viewmat[:3, :3] @ axes @ np.diag(np.asarray(scales, np.float64))
        means2d.append(focal * point[:2] / point[2] + middle)
        depths.append(point[2])
        covariances.append(M @ M.T)
    return np.array(means2d), np.array(depths), np.array(covariances)


def relative_errors(actual, expected):
    """Relative L2 error per field, in float64."""
    errors = {}
    for name in FIELDS:
        a, e = (np.asarray(getattr(x, name), np.float64) for x in (actual, expected))
        errors[name] = np.linalg.norm(a - e) / max(np.linalg.norm(e), 1e-12)
    return errors
