import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gsjax.analytic import solids
from gsjax.normals.from_depth import chosen_reduction, depth_normals, smoothed_depth_normals
from gsjax.scene.cameras import Camera, pixel_rays

K = np.float32([[70, 0, 25.5], [0, 64, 17.0], [0, 0, 1]])
CAMERA = Camera(jnp.eye(4, dtype=jnp.float32), jnp.asarray(K), 48, 36)
RAYS = np.asarray(pixel_rays(CAMERA), np.float64)


def plane_depth(normal, distance):
    """Depth of the plane n . P = -distance, n towards the camera."""
    return -distance / (RAYS @ normal)


def unit(vector):
    return np.asarray(vector, np.float64) / np.linalg.norm(vector)


def degrees_between(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def smoothed(depth, camera=CAMERA, alphas=None, **options):
    alphas = (depth > 0).astype(np.float32) if alphas is None else alphas
    return np.asarray(smoothed_depth_normals(jnp.asarray(depth, jnp.float32), jnp.asarray(alphas), camera, **options))


def reduced(depth):
    """Blocks that do not fill the image."""
    return smoothed(depth, reduction=5)


def raw(depth, camera=CAMERA):
    return np.asarray(depth_normals(jnp.asarray(depth, jnp.float32), camera))


@pytest.mark.parametrize(("normal", "scale"), [((0, 0, -1), 1e-4), ((-0.1, -1, -0.7), 1e4)])
@pytest.mark.parametrize("estimate", [raw, smoothed, reduced])
def test_a_plane_gives_its_normal_everywhere_at_any_scale(estimate, normal, scale):
    depth = plane_depth(unit(normal), scale)
    depth = np.where((depth > 0) & (depth < 20 * scale), depth, 0)
    inner = depth > 0
    assert inner.mean() > 0.3
    normals = estimate(depth)
    # Float32 depth over footprints of a hundredth of it; blocks that the border cuts are not seen at their centres.
    assert degrees_between(normals[inner], unit(normal)).max() < (0.6 if estimate is reduced else 0.2)
    assert np.all(normals[~inner] == 0)


def test_next_to_a_hole_the_difference_is_one_sided_and_without_neighbours_there_is_none():
    normal = unit((0.3, 0.2, -1))
    depth = plane_depth(normal, 2.0)
    depth[10, 20] = 0
    normals = raw(depth)
    assert np.all(normals[10, 20] == 0)
    for row, column in ((9, 20), (11, 20), (10, 19), (10, 21)):
        assert degrees_between(normals[row, column], normal) < 0.1
    depth = np.zeros((36, 48))
    depth[5, 5] = depth[20, 10:20] = 2.0  # a dot and a row one pixel high
    assert np.all(raw(depth) == 0)


def test_the_gradient_is_finite_at_holes_and_right_elsewhere():
    # Pixel rays are float32 whatever the camera is.
    with jax.enable_x64(True), jax.numpy_dtype_promotion("standard"):
        camera = Camera(jnp.eye(4), jnp.asarray(K, jnp.float64), 48, 36)
        rng = np.random.default_rng(0)
        depth = plane_depth(unit((0.3, 0.2, -1)), 2.0) + 0.01 * rng.standard_normal((36, 48))
        depth[rng.random(depth.shape) < 0.1] = 0
        weights = rng.standard_normal((36, 48, 3))

        total = jax.jit(jax.value_and_grad(lambda depth: jnp.sum(weights * depth_normals(depth, camera))))
        gradient = np.asarray(total(depth)[1])
        assert np.all(np.isfinite(gradient))
        direction = np.where(depth > 0, rng.standard_normal(depth.shape), 0)
        expected = (total(depth + 1e-7 * direction)[0] - total(depth - 1e-7 * direction)[0]) / 2e-7
        np.testing.assert_allclose(np.sum(gradient * direction), expected, rtol=1e-5)


def splat_like_noise(shape, seed, scale=1.0):
    """Unit variance, correlated over 2 to 6 pixels times `scale`, as splats of several sizes leave it."""
    rng = np.random.default_rng(seed)
    fields = [gaussian_filter(rng.standard_normal(shape), scale * size) for size in (1.0, 2.0, 3.0)]
    return sum(f / f.std() for f in fields) / np.sqrt(3)


@pytest.fixture(scope="module")
def scene_view():
    camera = solids.cameras(8, (160, 160))[2]
    return camera, jax.tree.map(np.asarray, solids.trace(camera, samples=1))


def test_smoothing_beats_raw_normals_of_a_noisy_depth(scene_view):
    camera, view = scene_view
    depth = view.depth * (1 + 0.01 * splat_like_noise(view.depth.shape, 0))
    maps = [raw(depth, camera), smoothed(depth, camera)]
    has_normal = np.all([np.any(m != 0, axis=-1) for m in maps], axis=0)
    assert has_normal.sum() > 0.97 * (view.depth > 0).sum()
    # Measured: 36 to 15 degrees everywhere, 33 to 18 on objects.
    for mask, factor in ((has_normal, 2.2), (has_normal & (view.labels < solids.GROUND_LABEL), 1.6)):
        before, after = (degrees_between(m, view.normals)[mask].mean() for m in maps)
        assert before > factor * after


def view_of(depth, camera):
    """A view as `chosen_reduction` reads it."""
    return jnp.asarray(depth, jnp.float32), jnp.asarray(depth > 0, jnp.float32), camera


@pytest.mark.parametrize("scale", [1, 4])
def test_windows_follow_the_size_of_the_bumps(scale):
    """The middle of a bumpy tilted plane, photographed with more and more pixels."""
    K = jnp.float32([[220 * scale, 0, 80], [0, 220 * scale, 80], [0, 0, 1]])
    camera, normal = Camera(jnp.eye(4, dtype=jnp.float32), K, 160, 160), unit((0.4, -0.3, -1))
    depth = -2.0 / (np.asarray(pixel_rays(camera), np.float64) @ normal)
    depth = depth * (1 + 0.005 * splat_like_noise(depth.shape, 0, scale))
    before = degrees_between(raw(depth, camera), normal).mean()
    reduction = chosen_reduction([view_of(depth, camera)])
    after = degrees_between(smoothed(depth, camera, reduction=reduction), normal).mean()
    assert reduction == scale
    assert before > 20
    assert after < 0.35 * before
    if scale > 1:
        assert degrees_between(smoothed(depth, camera), normal).mean() > 0.6 * before, "the smallest windows"


@pytest.mark.parametrize("amplitude", [0.0, 0.01])
def test_windows_stay_small_where_there_is_little_noise_or_shapes_are_small(scene_view, amplitude):
    camera, view = scene_view
    depth = view.depth * (1 + amplitude * splat_like_noise(view.depth.shape, 0))
    assert chosen_reduction([view_of(depth, camera)]) == 1


def roof(noise):
    """Two planes that meet in a ridge at column 24, rising and falling by 45 degrees."""
    left, right = unit((-1, 0, -1)), unit((1, 0, -1))
    ridge = np.array([(24.0 - K[0, 2]) / K[0, 0], 0, 1]) * 3
    depth = np.maximum(*(ridge @ n / (RAYS @ n) for n in (left, right)))
    sides = np.where(np.arange(48)[:, None] < 24, left, right)
    return depth * (1 + noise * splat_like_noise(depth.shape, 1)), np.broadcast_to(sides, (36, 48, 3))


def test_an_edge_stays_sharp_and_where_it_is():
    depth, truth = roof(0.0)
    away = np.abs(np.arange(48) - 23.5)
    assert degrees_between(smoothed(depth), truth)[:, away > 2].max() < 1
    assert degrees_between(smoothed(depth, reduction=2), truth)[:, away > 4].max() < 1, "larger windows"
    depth, truth = roof(0.004)
    normals = smoothed(depth)
    # Column by which the noisy map says that the left side ends.
    turns = np.sum(normals[:, 12:36, 0] < 0, axis=1) + 12
    assert np.abs(turns - 24).mean() < 1.0
    assert degrees_between(normals, truth)[:, away > 3].mean() < 0.5 * degrees_between(raw(depth), truth).mean()


def test_mixed_pixels_at_a_step_have_no_normal_and_the_rest_keeps_its_own():
    far, near = plane_depth(unit((0, -0.2, -1)), 4.0), plane_depth(unit((0.1, 0, -1)), 2.0)
    columns = np.arange(48)
    depth = np.where(columns < 20, near, far)
    depth[:, 20] = 0.5 * (near + far)[:, 20]
    normals = smoothed(depth)
    assert np.all(normals[:, 20] == 0)
    truth = np.where(columns[:, None] < 20, unit((0.1, 0, -1)), unit((0, -0.2, -1)))
    others = np.abs(columns - 20) > 1
    assert degrees_between(normals, truth)[:, others].max() < 1


def test_what_is_not_covered_has_no_normal():
    depth = plane_depth(unit((0, 0, -1)), 2.0)
    alphas = np.where(np.arange(48) < 30, 0.9, 0.4).astype(np.float32) * np.ones((36, 1), np.float32)
    normals = smoothed(np.where(alphas > 0.5, depth, 50 * depth), alphas=alphas)
    assert np.all(normals[:, 30:] == 0)
    assert degrees_between(normals[:, :30], [0, 0, -1]).max() < 0.1
    assert np.all(smoothed(np.zeros((36, 48))) == 0)


@pytest.mark.parametrize("estimate", [raw, smoothed])
def test_a_depth_of_another_size_is_an_error(estimate):
    with pytest.raises(ValueError, match=r"\(48, 36\).*camera.height=36, camera.width=48"):
        estimate(np.ones((48, 36)))
