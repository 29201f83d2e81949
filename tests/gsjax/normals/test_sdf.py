from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from small_scenes import angles, camera_at, plane
from tolerances import assert_close

from gsjax import rendering
from gsjax.normals import sdf
from gsjax.rendering import View
from gsjax.scene import cameras

CAMERA = camera_at((0.6, -0.4, -0.5), (0.1, 0.2, 4.0), size=(40, 36), focal=36.0)
TURN = np.asarray(CAMERA.viewmat, np.float64)[:3, :3]
CENTER = np.asarray(cameras.center(CAMERA), np.float64)
K = np.asarray(CAMERA.K, np.float64)


def unit(v):
    return np.asarray(v, np.float64) / np.linalg.norm(v)


def rays_through(pixels):
    """Camera-frame rays with z = 1 of `[..., 2]` pixel positions."""
    return np.concatenate([(pixels - K[:2, 2]) / np.diag(K)[:2], np.ones((*pixels.shape[:-1], 1))], -1)


RAYS = rays_through(np.stack(np.meshgrid(np.arange(40) + 0.5, np.arange(36) + 0.5), -1))
# There a patch's slope is central.
CORNERS = np.stack(np.meshgrid(np.arange(4.0, 37), np.arange(4.0, 33)), -1)


def plane_depth(normal, rays=RAYS):
    """Camera z of the plane through (0, 0, 4) along the rays; `normal` is in the world."""
    return (normal @ (np.array([0, 0, 4.0]) - CENTER)) / (rays @ TURN @ normal)


def in_world(points_cam):
    return jnp.asarray(points_cam @ TURN + CENTER, jnp.float32)


def gradients(points_cam, depth):
    """Gradients of the estimate at `[P, 3]` camera-frame points, world frame."""
    return np.asarray(gradients_of_all(in_world(points_cam), jnp.asarray(depth, jnp.float32), CAMERA), np.float64)


gradients_of_all = jax.jit(jax.vmap(jax.grad(sdf.depth_sdf), (0, None, None)))
value_and_gradients = jax.jit(jax.value_and_grad(sdf.depth_sdf, argnums=(0, 1, 2)))


@jax.jit
def maps(gaussians, camera):
    black = jnp.zeros(3, jnp.float32)
    view = rendering.render(gaussians, camera, capacity=8192, background=black, with_depth=True)
    estimates = {e.__name__: e(gaussians, view, camera) for e in ESTIMATORS}
    return view.alphas, estimates


@jax.jit
def pixel_map(depth, camera):
    return sdf.pixel_depth_map(None, View(None, None, depth, None), camera)


ESTIMATORS = (sdf.sdf_gradient_map, sdf.pixel_depth_map)


# --- the estimate at one point


def test_on_a_plane_the_gradient_is_the_normal_over_its_cosine_with_the_ray():
    normal = unit((-0.5, 0.4, -1.0))
    rays = rays_through(CORNERS.reshape(-1, 2))
    vectors = gradients(rays * plane_depth(normal, rays)[:, None], plane_depth(normal))
    assert angles(vectors, np.broadcast_to(normal, vectors.shape)).max() < 0.3
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=-1), 1 / np.abs(rays @ TURN @ normal), rtol=3e-3)


def test_the_estimate_is_the_distance_along_z_positive_in_front():
    depth = plane_depth(unit((0.3, 0.2, -1.0)))
    for distance in (-0.7, 0.4):
        point = in_world(RAYS[13, 20] * (depth[13, 20] - distance))
        value, _ = value_and_gradients(point, jnp.asarray(depth, jnp.float32), CAMERA)
        assert float(value) == pytest.approx(distance, abs=2e-5)


OFF_SCREEN = {
    "beside": (50.0, 0.0, 2.0),
    "far beside": (0.0, -900.0, 0.1),
    "camera plane": (0.3, 0.2, 0.0),
    "behind": (0.3, 0.2, -3.0),
    "camera centre": (0.0, 0.0, 0.0),
    "almost on the plane": (1e-3, 0.0, 1e-9),
}


def test_off_screen_and_behind_the_estimate_is_finite():
    depth = jnp.asarray(plane_depth(unit((0.3, 0.2, -1.0))), jnp.float32)
    for name, in_camera in OFF_SCREEN.items():
        everything = value_and_gradients(in_world(np.array(in_camera)), depth, CAMERA)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(everything)), name


# --- the maps


def interior(alphas, margin=6):
    mask = np.zeros(alphas.shape, bool)
    mask[margin:-margin, margin:-margin] = True
    return mask & (np.asarray(alphas) > 0.9)


def test_on_a_plane_of_gaussians_every_estimator_gives_the_normal_facing_the_camera():
    normal = unit((-0.5, 0.3, -1.0))
    alphas, estimates = maps(plane(normal), CAMERA)
    mask = interior(alphas) & np.any(estimates["pixel_depth_map"], -1)
    assert mask.sum() > 400
    for name, bound in (("sdf_gradient_map", 2), ("pixel_depth_map", 4)):
        off = angles(estimates[name][mask], np.broadcast_to(TURN @ normal, (mask.sum(), 3)))
        assert np.median(off) < bound, name
        assert off.max() < 45, name  # on the camera's side, everywhere


def test_the_pixel_map_of_an_exact_plane_is_its_normal_and_nothing_at_the_border():
    normal = unit((0.3, 0.2, -1.0))
    normals = np.asarray(pixel_map(jnp.asarray(plane_depth(normal), jnp.float32), CAMERA))
    assert angles(normals[1:-1, 1:-1], np.broadcast_to(TURN @ normal, (34, 38, 3))).max() < 0.02
    for border in (normals[0], normals[-1], normals[:, 0], normals[:, -1]):
        assert not border.any()


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_the_pixel_map_counts_at_every_scale_and_focal_length(scale):
    # Neighbouring pixels of a photo are a thousandth of the depth apart: short steps, but no short directions.
    camera = cameras.Camera(CAMERA.viewmat, CAMERA.K * jnp.asarray([[50.0], [50.0], [1.0]]), 40, 36)
    directions = pixel_map(jnp.full((36, 40), scale, jnp.float32), camera)
    sideways = jnp.broadcast_to(jnp.asarray([1.0, 0, 0]), directions.shape)
    assert float(sdf.misalignment(directions, sideways, jnp.ones((36, 40), bool))) == pytest.approx(1, abs=1e-5)


def test_uncovered_neighbours_leave_no_direction_and_no_nan():
    depth = np.full((36, 40), 3.0, np.float32)
    depth[10, 12] = 0

    normals = np.asarray(pixel_map(jnp.asarray(depth), CAMERA))
    missing = ~normals.any(-1)
    assert all(missing[r, c] for r, c in ((9, 12), (11, 12), (10, 11), (10, 13)))
    assert missing[1:-1, 1:-1].sum() == 4
    gradient = jax.jit(jax.grad(lambda depth: jnp.sum(pixel_map(depth, CAMERA))))(jnp.asarray(depth))
    assert bool(jnp.isfinite(gradient).all())


# --- means that read no surface

HOLE = np.s_[14:22, 22:30]  # pixels without depth, as beyond a silhouette
STRAY_PIXELS = np.array(
    [
        [12.0, 10.0],  # well on the surface
        [21.4, 18.0],  # its four pixels are columns 20 and 21: the last before the hole
        [21.6, 18.0],  # columns 21 and 22: touches the hole
        [26.0, 18.0],  # in the hole
        [30.4, 22.4],  # touches the hole's last pixel with one corner
        [30.6, 22.4],
        [0.6, 5.0],  # on the outermost centres
        [0.4, 5.0],  # in the image, outside its outermost centres: the border value is read, without slope
        [-3.0, 5.0],  # beside the image
        [20.0, 38.0],  # below it
        [39.6, 35.6],
    ]
)
READS = np.array([1, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0], bool)


@pytest.fixture
def strays(monkeypatch):
    """Means on a plane that project to `STRAY_PIXELS`, its exact depth with a hole, its normal in the camera, and the
    estimator before it composites: `[N, 3]` directions from (means, depth)."""
    normal = unit((0.3, 0.2, -1.0))
    rays = rays_through(STRAY_PIXELS)
    depth = plane_depth(normal).astype(np.float32)
    depth[HOLE] = 0
    monkeypatch.setattr(rendering, "features", lambda splats, values: (values, None))
    all_visible = SimpleNamespace(projection=SimpleNamespace(visible=np.ones((1, len(rays)), bool)))

    def directions(means, depth):
        return sdf.sdf_gradient_map(SimpleNamespace(means=means), View(None, None, depth, all_visible), CAMERA)

    return in_world(rays * plane_depth(normal, rays)[:, None]), jnp.asarray(depth), TURN @ normal, directions


def test_means_that_read_no_depth_have_no_direction_and_get_and_give_no_gradient(strays):
    means, depth, normal, directions = strays
    towards = jnp.asarray(np.random.default_rng(0).normal(size=means.shape), jnp.float32)

    @jax.jit
    @partial(jax.grad, argnums=(0, 1), has_aux=True)
    def gradients_and_vectors(means, depth):
        vectors = directions(means, depth)
        return jnp.sum(vectors * towards), vectors

    (to_means, to_depth), vectors = jax.tree.map(np.asarray, gradients_and_vectors(means, depth))
    for rows in (vectors, to_means):
        np.testing.assert_array_equal(np.any(rows != 0, axis=1), READS)
    assert angles(vectors[READS], np.tile(normal, (READS.sum(), 1))).max() < 0.3
    low = np.floor(STRAY_PIXELS[READS] - 0.5).astype(int)
    is_read = np.zeros((36, 40), bool)
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
        is_read[low[:, 1] + down, low[:, 0] + right] = True
    np.testing.assert_array_equal(to_depth != 0, is_read)
    assert np.isfinite(to_means).all() and np.isfinite(to_depth).all()


# --- the loss


MOST = 50
of_misalignment = jax.jit(jax.value_and_grad(sdf.misalignment))
of_doubted = jax.jit(jax.value_and_grad(sdf.doubted_misalignment))


def misaligned(directions, normals, valid=None):
    """The loss and its gradient; invalid pixels fill the rest, so that one program serves all."""
    count = len(directions)
    padded = (np.pad(np.asarray(x, np.float32), ((0, MOST - count), (0, 0)))[None] for x in (directions, normals))
    valid = np.pad(np.ones(count, bool) if valid is None else valid, (0, MOST - count))[None]
    value, gradient = of_misalignment(*padded, valid)
    assert not np.any(gradient[:, count:])
    return value, gradient[:, :count]


def test_misalignment_is_the_mean_of_one_minus_the_unsigned_cosine():
    rng = np.random.default_rng(0)
    directions, normals = rng.normal(size=(2, 50, 3))
    valid = rng.random(50) > 0.4
    cosine = np.sum(directions * normals, -1) / np.linalg.norm(directions, axis=-1) / np.linalg.norm(normals, axis=-1)
    value, gradient = misaligned(directions, normals, valid)
    counted = np.minimum(np.linalg.norm(normals, axis=-1), 1) * valid
    assert_close(value, np.sum((1 - np.abs(cosine)) * counted) / counted.sum())
    assert 0 < float(value) < 1
    assert not np.any(np.asarray(gradient)[0, ~valid]) and np.all(np.any(np.asarray(gradient)[0, valid], -1))


@pytest.mark.parametrize("measure", [sdf.misalignment, sdf.doubted_misalignment])
def test_the_gradient_of_misalignment_equals_finite_differences(measure, x64):
    directions, normals = np.random.default_rng(2).normal(size=(2, 4, 3, 3))
    normals[1, 1] = 0
    valid = jnp.asarray(np.arange(12).reshape(4, 3) != 7)
    check_grads(jax.jit(lambda d: measure(d, jnp.asarray(normals), valid)), (jnp.asarray(directions),), 1, ["rev"])


def test_a_doubted_pixel_has_the_least_that_any_confidence_gives_it():
    turns = np.radians([0, 10, 25, 27, 60, 90])
    directions = jnp.asarray(np.stack([np.sin(turns), 0 * turns, np.cos(turns)], -1)[None], jnp.float32)
    normals = jnp.zeros((1, len(turns), 3)).at[..., 2].set(1.0)
    confidence = np.linspace(1e-3, 1, 100_000)[:, None]
    errors = 1 - np.cos(turns)
    least = np.min(confidence * errors - sdf.DOUBT * np.log(confidence), axis=0)
    for index, expected in enumerate(least):
        valid = jnp.arange(len(turns))[None] == index
        value, gradient = of_doubted(directions, normals, valid)
        assert float(value) == pytest.approx(expected, abs=1e-5)
        assert np.all(np.isfinite(gradient))
        if errors[index] <= sdf.DOUBT:
            assert_close(value, misaligned(directions[0], normals[0], valid[0])[0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_both_signs_of_the_normal_are_minima_of_value_zero(sign):
    normals = np.random.default_rng(1).normal(size=(20, 3))
    value, gradient = misaligned(sign * 3 * normals, normals)
    assert_close(value, np.float32(0), rtol=0, atol=3e-7, why="rounding of a unit vector")
    assert_close(gradient, np.zeros((1, 20, 3)), rtol=0, atol=1e-7, why="rounding of a unit vector")
    assert float(misaligned([[1.0, 0, 0]], [[0, 1.0, 0]])[0]) == 1


@pytest.mark.parametrize(
    ("directions", "normals"),
    [([[0.0, 0, 0]], [[0, 0, 1.0]]), ([[5e-4, 0, 0]], [[0, 0, 1.0]]), ([[1.0, 0, 0]], [[0, 0, 0.0]])],
    ids=["no direction", "too short", "no normal"],
)
def test_what_has_no_direction_does_not_count(directions, normals):
    value, gradient = misaligned(directions, normals)
    assert float(value) == 0 and not np.any(gradient)
    value, gradient = misaligned(np.ones((4, 3)), np.eye(4, 3), np.zeros(4, bool))
    assert float(value) == 0 and not np.any(gradient), "no valid pixel"
    value, _ = misaligned([*directions, [1.0, 1.0, 0]], [*normals, [0, 1.0, 0]])
    assert float(value) == pytest.approx(1 - 0.5**0.5, abs=1e-6)
