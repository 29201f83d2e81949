"""Depth that knows a splat's slope: conditional means written out in float64, a tilted plane, and its bound."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import cloud, intrinsics, make, render, textbook
from scipy.spatial.transform import Rotation

from rasterizer import Projection, blended_depth, depth_channels, project, quat_scale_to_covar_preci

SIGMAS = 3.33


@pytest.fixture(scope="module")
def splats():
    def run(scene, covars=None, **options):
        s = scene
        shape = (s.quats, s.scales) if covars is None else (None, None)
        arrays = s.means, *shape, s.opacities, s.viewmats, s.Ks, s.width, s.height
        return project(*arrays, covars=covars, depth_mode="plane", **options)

    return jax.jit(run, static_argnames=("eps2d", "near_plane", "rasterize_mode"))


def conditional_slopes(scene, eps2d=0.3, near_plane=0.01):
    """`[N, 2]` of E[z | u, v], made flatter where 3.33 standard deviations reach the near plane."""
    _, depths, joint = textbook(scene)
    slopes = np.array([np.linalg.solve(S[:2, :2] + eps2d * np.eye(2), S[:2, 2]) for S in joint])
    reach = SIGMAS * np.sqrt(np.sum(slopes * joint[:, :2, 2], -1))
    return slopes * np.minimum(1, (depths - near_plane) / np.maximum(reach, 1e-300))[:, None]


@pytest.mark.parametrize(
    ("of_covariances", "options"), [(False, {}), (True, {"eps2d": 0.1, "rasterize_mode": "antialiased"})]
)
def test_slopes_are_those_of_the_conditional_mean(splats, of_covariances, options):
    scene = cloud(seed=1)
    covars = quat_scale_to_covar_preci(scene.quats, scene.scales)[0] if of_covariances else None
    projection = splats(scene, covars, **options)
    expected = conditional_slopes(scene, options.get("eps2d", 0.3))
    error = np.linalg.norm(projection.slopes[0] - expected, axis=-1)
    assert projection.visible.sum() > 20
    # A covariance has lost the digits that thin axes need.
    assert np.max(error) < (1e-4 if of_covariances else 3e-6) * np.abs(expected).max()


def test_no_splat_shows_a_depth_behind_the_near_plane_nor_far_from_its_centres(splats):
    # Large ones, close to the camera and beside the image.
    scene = cloud(seed=2)
    scene = replace(scene, scales=4 * scene.scales, means=scene.means * jnp.array([[1.5, 1.5, 0.4]]))
    near = 0.2
    p = splats(scene, near_plane=near)
    _, _, joint = textbook(scene)
    y, x = np.mgrid[: scene.height, : scene.width] + 0.5
    flattened = 0
    for n in np.flatnonzero(p.visible[0]):
        xx, xy, yy = np.asarray(p.conics[0, n], np.float64)
        mean2d, slope = (np.asarray(part[0, n], np.float64) for part in (p.means2d, p.slopes))
        dx, dy = x - mean2d[0], y - mean2d[1]
        sigmas = np.sqrt(xx * dx * dx + 2 * xy * dx * dy + yy * dy * dy)
        is_drawn = np.asarray(scene.opacities, np.float64)[n] * np.exp(-0.5 * sigmas**2) >= 1 / 255
        offset = slope[0] * dx + slope[1] * dy
        z = float(p.depths[0, n])
        assert np.all(np.abs(offset) <= np.sqrt(joint[n, 2, 2]) * sigmas * (1 + 1e-5) + 1e-6)
        assert np.all(z + offset[is_drawn] >= near - 1e-5 * z)
        flattened += np.linalg.norm(slope) < 0.99 * np.linalg.norm(
            np.linalg.solve(joint[n, :2, :2] + 0.3 * np.eye(2), joint[n, :2, 2])
        )
    assert 0 < flattened < p.visible.sum()


def test_a_tilted_wall_of_discs_has_the_depth_of_its_plane():
    """Discs on a plane through (0, 0, 4), four pixels apart, before a camera at the origin."""
    normal = np.array([0.4, -0.6, -1.0]) / np.linalg.norm([0.4, -0.6, -1.0])
    x = np.cross([0.0, 1.0, 0.0], normal)
    x /= np.linalg.norm(x)
    turn = Rotation.from_matrix(np.stack([x, np.cross(normal, x), normal], -1)).as_quat()[[3, 0, 1, 2]]
    steps = 0.25 * np.arange(-10, 11)
    u, v = (part.reshape(-1, 1) for part in np.meshgrid(steps, steps))
    points, K = u * x + v * np.cross(normal, x) + [0, 0, 4], intrinsics(37, 29, fx=60.0)
    count = len(points)
    scene = make(
        37,
        29,
        means=points,
        quats=np.tile(turn, (count, 1)),
        scales=np.tile([0.2, 0.2, 1e-4], (count, 1)),
        opacities=np.full(count, 0.9),
        colors=np.zeros((count, 1)),
        viewmats=[np.eye(4)],
        Ks=[K],
        backgrounds=np.zeros((1, 1)),
    )
    how = {"render_mode": "ED", "capacity": 4096, "backend": "xla"}
    modes = (render(scene, depth_mode=mode, **how) for mode in ("plane", "center"))
    (plane, alphas, info), (center, _, of_centers) = modes
    assert info["slopes"] is not None and of_centers["slopes"] is None
    rows, columns = np.mgrid[:29, :37] + 0.5
    rays = np.stack([(columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1], np.ones_like(rows)], -1)
    inside = np.asarray(alphas[0, ..., 0]) > 0.99
    assert inside.mean() > 0.9
    expected = 4 * normal[2] / (rays @ normal)
    of_plane, of_center = (np.abs(d[0, ..., 0] - expected)[inside] for d in (plane, center))
    assert of_plane.mean() < 0.15 * of_center.mean()
    # What is left: the blur makes the slope flatter, and what is linear in the image is not in space.
    assert of_plane.max() < 0.05


def test_a_steep_plane_at_the_rim_of_a_wide_image_loses_a_rounding_of_half_its_width():
    width, slope, mean2d, depth = 4096, 0.7, 4090.3, 3.0
    scene = Projection(
        means2d=jnp.array([[[mean2d, 1.2]]], jnp.float32),
        depths=jnp.array([[depth]], jnp.float32),
        conics=jnp.ones((1, 1, 3)),
        extents=jnp.ones((1, 1, 2)),
        visible=jnp.ones((1, 1), bool),
        slopes=jnp.array([[[slope, -0.1]]], jnp.float32),
    )
    everywhere = jnp.broadcast_to(depth_channels(scene, width, 2)[:, :, None], (1, 2, width, 3))
    y, x = np.mgrid[:2, :width] + 0.5
    expected = depth + slope * (x - mean2d) - 0.1 * (y - 1.2)
    error = np.abs(blended_depth(everywhere)[0, ..., 0] - expected)
    assert error.max() < 2e-7 * slope * width / 2
