"""The other readings of the gradient: closed forms, finite differences, and places without a direction."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expit
from small_scenes import angles, camera_at, cloud, plane
from terms import density, evaluation_points, slopes, surroundings
from tolerances import assert_close

from gsjax import cameras, render
from gsjax.gaussians import rotation_matrices, smallest_axes
from gsjax.render import View
from gsjax.training.terms import Kept

pytestmark = pytest.mark.long  # what studies alone hand in

COUNT = 64  # of every scene here: one program in float64, and one in float32
CAMERA = camera_at((0.6, -0.4, -0.5), (0.1, 0.2, 4.0), size=(40, 36), focal=36.0)
TURN = np.asarray(CAMERA.viewmat, np.float64)[:3, :3]
CENTER = np.asarray(cameras.center(CAMERA), np.float64)
KEY = jax.random.key(5)
NORMAL = np.array([0.3, 0.2, -1.0]) / np.linalg.norm([0.3, 0.2, -1.0])
RAYS = np.asarray(cameras.pixel_rays(CAMERA), np.float64)
PLANE_DEPTH = (NORMAL @ (np.array([0, 0, 4.0]) - CENTER)) / (RAYS @ TURN @ NORMAL)
READINGS = (
    slopes.sdf_central_map,
    slopes.sdf_bicubic_map,
    slopes.sdf_offset_map,
    density.density_center_map,
    density.density_offset_map,
    density.density_sample_map,
)
CENTRAL, BICUBIC, OFFSET, AT_CENTER, AT_OFFSET, AT_SAMPLE = range(6)


@pytest.fixture(autouse=True)
def _not_composited(monkeypatch):
    """An estimator's directions before they are composited: `[N, 3]`, camera frame, unit, facing the camera."""
    monkeypatch.setattr(render, "features", lambda splats, values: (values, None))


@jax.jit
def traced(towards, gaussians, depth, nearest, visible):
    splats = SimpleNamespace(projection=SimpleNamespace(visible=visible[None]))
    camera = jax.tree.map(lambda leaf: leaf.astype(depth.dtype), CAMERA)

    def total(gaussians, depth):
        view, kept = View(None, None, depth, splats), Kept(nearest, KEY, 1.0)
        of_depth = [reading(gaussians, view, camera) for reading in READINGS[:AT_CENTER]]
        found = jnp.stack([*of_depth, *(reading(gaussians, view, camera, kept) for reading in READINGS[AT_CENTER:])])
        return jnp.sum(towards * found), found

    return jax.value_and_grad(total, (0, 1), has_aux=True)(gaussians, depth)


def everything(gaussians, depth=PLANE_DEPTH, *, towards=1.0, nearest=None, visible=None):
    """((sum, directions [6, N, 3]), gradients of the sum to Gaussians and depth)."""
    kind = gaussians.means.dtype
    nearest = surroundings.nearest(gaussians) if nearest is None else nearest
    visible = np.ones(COUNT, bool) if visible is None else visible
    towards = jnp.asarray(np.broadcast_to(towards, (6, COUNT, 3)), kind)
    return traced(towards, gaussians, jnp.asarray(depth, kind), jnp.asarray(nearest), jnp.asarray(visible))


def directions(gaussians, *arguments, **more):
    return np.asarray(everything(gaussians, *arguments, **more)[0][1])


def in_float64(gaussians):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), gaussians)


def drawn_offsets(gaussians):
    """Axes, deviations, and how many deviations along each the drawn places lie off, float64."""
    noise = np.asarray(jax.random.normal(KEY, gaussians.means.shape, gaussians.means.dtype))
    axes = np.asarray(rotation_matrices(gaussians.quats))
    return axes, np.exp(np.asarray(gaussians.log_scales)), 1.5 * noise


# --- of the density


def test_of_a_gaussian_alone_the_density_has_a_gradient_in_closed_form(x64):
    gaussians = in_float64(cloud(COUNT, seed=3))
    towards = CENTER - np.asarray(gaussians.means)
    found = directions(gaussians, nearest=surroundings.none_yet(COUNT))
    assert not np.any(found[AT_CENTER])  # nothing of itself at its own mean
    axes, deviations, noise = drawn_offsets(gaussians)
    worlds = {
        AT_OFFSET: np.asarray(smallest_axes(gaussians)),
        AT_SAMPLE: np.einsum("nij,nj->ni", axes, noise / deviations),  # Sigma^-1 (x - mu)
    }
    for reading, world in worlds.items():
        facing = world * np.sign(np.sum(world * towards, -1, keepdims=True)) @ TURN.T
        expected = facing / np.linalg.norm(facing, axis=-1, keepdims=True)
        has_any = np.any(found[reading] != 0, -1)
        assert has_any.sum() > 60  # far out the density is nothing
        assert_close(found[reading][has_any], expected[has_any], rtol=0, atol=1e-6, why="a camera of float32")


def test_of_many_gaussians_the_gradient_is_the_weighted_sum(x64):
    gaussians = in_float64(cloud(COUNT, seed=4))
    axes, deviations, noise = drawn_offsets(gaussians)
    means, alpha = np.asarray(gaussians.means), expit(np.asarray(gaussians.logit_opacities))
    points = means + np.einsum("nij,nj->ni", axes, noise * deviations)
    inverse = np.einsum("nij,nj,nkj->nik", axes, 1 / deviations**2, axes)
    ids = surroundings.nearest(gaussians)
    offsets = points[:, None] - means[ids]
    pull = np.einsum("nkij,nkj->nki", inverse[ids], offsets)
    weights = alpha[ids] * np.exp(-0.5 * np.sum(offsets * pull, -1))
    world = np.sum(weights[..., None] * pull, 1)
    world *= np.sign(np.sum(world * (CENTER - means), -1, keepdims=True))
    found = directions(gaussians)[AT_SAMPLE]
    has_any = np.any(found != 0, -1)
    assert has_any.sum() > 60
    assert angles(found[has_any], (world @ TURN.T)[has_any]).max() < 1e-3


def test_on_a_plane_the_density_has_its_normal_off_the_means_and_lies_in_the_plane_at_them(x64):
    found = directions(in_float64(plane(NORMAL, per_side=8, radius=0.4)))
    assert angles(found[AT_OFFSET], np.broadcast_to(TURN @ NORMAL, (COUNT, 3))).max() < 5  # at the rim neighbours pull
    has_any = np.any(found[AT_CENTER] != 0, -1)
    assert has_any.sum() > 20
    assert np.abs(found[AT_CENTER][has_any] @ TURN @ NORMAL).max() < 0.05  # means of float32


# --- of the depth


def test_on_an_exact_plane_every_slope_gives_its_normal(x64):
    found = directions(in_float64(plane(NORMAL, per_side=8, spacing=0.3)))
    for reading in (CENTRAL, BICUBIC, OFFSET):
        has_any = np.any(found[reading] != 0, -1)
        assert has_any.sum() > 40
        assert angles(found[reading][has_any], np.broadcast_to(TURN @ NORMAL, (has_any.sum(), 3))).max() < 0.3


def test_places_that_blend_a_pixel_without_depth_have_no_direction(x64):
    wall = plane(NORMAL, per_side=8, spacing=0.45)
    depth = PLANE_DEPTH.copy()
    depth[14:22, 22:30] = 0
    found = directions(in_float64(wall), depth)
    K = np.asarray(CAMERA.K, np.float64)
    for reading, where, reach in (
        (CENTRAL, wall.means, 1),
        (BICUBIC, wall.means, 1),
        (OFFSET, evaluation_points.before(wall, CAMERA), 0),
    ):
        points = (np.asarray(where) - CENTER) @ TURN.T
        expected = []
        for x, y in np.floor(points[:, :2] / points[:, 2:] * np.diag(K)[:2] + K[:2, 2] - 0.5).astype(int):
            columns, rows = np.arange(x - reach, x + 2 + reach), np.arange(y - reach, y + 2 + reach)
            inside = columns[0] >= 0 and columns[-1] < 40 and rows[0] >= 0 and rows[-1] < 36
            expected.append(bool(inside and depth[np.ix_(rows, columns)].all()))
        assert 20 < sum(expected) < 60
        np.testing.assert_array_equal(np.any(found[reading] != 0, -1), expected)


# --- gradients and hard cases


@pytest.mark.parametrize("reading", range(6), ids=lambda reading: READINGS[reading].__name__)
def test_gradients_equal_finite_differences(reading, x64):
    rng = np.random.default_rng(0)
    gaussians = in_float64(cloud(COUNT, seed=2))
    depth = PLANE_DEPTH + 0.05 * rng.normal(size=PLANE_DEPTH.shape)
    towards = np.zeros((6, COUNT, 3))
    towards[reading] = rng.normal(size=(COUNT, 3))
    nearest = surroundings.nearest(gaussians)
    step = {name: 1e-6 * rng.normal(size=leaf.shape) for name, leaf in gaussians.__dict__.items() if leaf is not None
            and name in ("means", "quats", "log_scales", "logit_opacities")}  # fmt: skip
    depth_step = 1e-6 * rng.normal(size=depth.shape)

    def moved(sign):
        there = replace(gaussians, **{name: getattr(gaussians, name) + sign * d for name, d in step.items()})
        return everything(there, depth + sign * depth_step, towards=towards, nearest=nearest)

    (_, found), (to_gaussians, to_depth) = moved(0)
    change = 0.5 * (float(moved(1)[0][0]) - float(moved(-1)[0][0]))
    expected = sum(float(np.sum(getattr(to_gaussians, name) * d)) for name, d in step.items())
    expected += float(np.sum(to_depth * depth_step))
    assert np.any(found[reading]) and abs(expected) > 1e-7
    assert change == pytest.approx(expected, rel=1e-4)


BASE = plane(NORMAL, per_side=8, spacing=0.3)
HARD = {
    "coincident": replace(BASE, means=jnp.tile(BASE.means[:1], (COUNT, 1))),
    "opaque": replace(BASE, logit_opacities=jnp.full(COUNT, 90, jnp.float32)),
    "gone": replace(BASE, logit_opacities=jnp.full(COUNT, -200, jnp.float32)),
    "needles": replace(BASE, log_scales=jnp.tile(jnp.asarray([[-18.0, 1.0, -18.0]]), (COUNT, 1))),
    "collapsed": replace(BASE, log_scales=jnp.full((COUNT, 3), -90.0)),
    "huge": replace(BASE, log_scales=jnp.full((COUNT, 3), 20.0)),
    "no rotation": replace(BASE, quats=jnp.zeros((COUNT, 4))),
    "at the camera": replace(BASE, means=jnp.tile(jnp.asarray(CENTER, jnp.float32), (COUNT, 1))),
    "behind": replace(BASE, means=-BASE.means),
    "beside": replace(BASE, means=BASE.means + jnp.asarray([9.0, 0, 0])),
}


@pytest.mark.parametrize("name", HARD)
def test_hard_places_are_finite_in_value_and_gradient(name):
    for table in (surroundings.nearest(HARD[name]), surroundings.none_yet(COUNT)):
        every = everything(HARD[name], nearest=table)
        assert all(bool(np.isfinite(leaf).all()) for leaf in jax.tree.leaves(every))


def test_what_is_not_in_view_adds_nothing():
    visible = np.arange(COUNT) % 3 == 0
    found = directions(plane(NORMAL, per_side=8, radius=0.4), visible=visible)
    assert not np.any(found[:, ~visible])
    assert all(np.any(each) for each in found[:, visible])
