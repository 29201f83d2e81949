"""The sphere that causes of wrong depth are measured on, and the order that every pixel finds by itself."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

CLOSE = {"rtol": 0, "atol": 2e-5}  # of colours in float32, two orders of the same sums


@pytest.fixture
def sphere(scripts):
    return scripts("painted_sphere")


@pytest.fixture
def study(scripts):
    return scripts("too_deep")


def test_points_at_the_true_depth_lie_on_the_sphere_and_face_the_camera(sphere):
    for viewmat in sphere.viewmats(0.1)[::8]:
        np.testing.assert_allclose(viewmat[:3, :3] @ viewmat[:3, :3].T, np.eye(3), atol=1e-12)
        center, ray = sphere.rays(viewmat)
        depth = sphere.depth(viewmat)
        points = (center + depth[..., None] * ray)[depth > 0]
        np.testing.assert_allclose(np.linalg.norm(points, axis=-1), 1, atol=1e-12)
        assert (np.sum(points * (center - points), -1) > 0).all()
        # A disc of asin(1 / 4) radians, seen at focal length 100.
        assert (depth > 0).sum() == pytest.approx(np.pi * (100 * np.tan(np.arcsin(1 / 4))) ** 2, rel=0.02)


@pytest.mark.parametrize("radius", [1.0, 0.97])
def test_a_sphere_that_is_smaller_lies_so_much_too_deep(sphere, radius):
    def draw(viewmat):
        """The picture of a sphere of another radius: the world shrunk, the camera moved along."""
        shrunk = np.asarray(viewmat, np.float64)
        shrunk[:3, 3] /= radius
        depths = radius * sphere.depth(shrunk)
        return sphere.Drawn(np.zeros((*depths.shape, 3)), np.ones_like(depths), depths)

    assert sphere.offset(draw, sphere.viewmats()[::10]) == pytest.approx(1e3 * (radius - 1), abs=1e-3)


def test_photos_are_means_over_pixels(sphere):
    """Four times as many rays change a pixel by little inside, and black lies behind."""
    viewmat = sphere.viewmats()[3]
    photo = sphere.photo(viewmat)
    center, ray = sphere.rays(viewmat)
    inner = sphere.inside(viewmat)
    seen = sphere.paint(center + sphere.depth(viewmat)[..., None] * ray)
    assert np.abs(photo - seen)[inner].max() < 0.1 < seen[inner].std()
    assert not photo[0, 0].any()


def splats_of(study, means, normals, colors, opacity=0.9):
    """Thin discs among as many that are not there."""
    quats = np.stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(means))], -1)
    absent = study.COUNT - len(means)
    return study.Splats(
        jnp.float32(np.pad(means, ((0, absent), (0, 0)))),
        jnp.float32(np.concatenate([quats, np.tile([1.0, 0, 0, 0], (absent, 1))])),
        jnp.log(jnp.float32(np.tile([0.15, 0.15, 0.002], (study.COUNT, 1)))),
        jnp.where(jnp.arange(study.COUNT) < len(means), jax.scipy.special.logit(opacity), -20.0),
        jnp.float32(np.pad(colors, ((0, absent), (0, 0)))),
    )


def test_layers_that_do_not_cross_are_drawn_as_the_library_draws_them(study, sphere):
    """Parallel discs one behind the other, in any order of rows: value and gradient."""
    viewmat = jnp.eye(4).at[2, 3].set(4.0)
    rng = np.random.default_rng(0)
    means = np.stack([*rng.uniform(-0.5, 0.5, (2, 30)), rng.permutation(np.linspace(-0.6, 0.6, 30))], -1)
    splats = splats_of(study, means, np.tile([0.0, 0.0, 1.0], (30, 1)), rng.uniform(size=(30, 3)))
    ways = [jax.jit(partial(draw, viewmat=viewmat, filtered=study.MIP)) for draw in (study.in_tiles, study.by_pixel)]
    for ours, theirs in zip(*(way(splats) for way in ways), strict=True):
        seen = np.asarray(ways[0](splats).alphas) > 0.01
        np.testing.assert_allclose(np.asarray(ours)[seen], np.asarray(theirs)[seen], **CLOSE)
    weights = jnp.float32(rng.normal(size=(sphere.SIZE, sphere.SIZE, 3)))
    slopes = [jax.jit(jax.grad(lambda s, way=way: jnp.sum(way(s).colors * weights)))(splats) for way in ways]
    for name, ours, theirs in zip(splats._fields, *slopes, strict=True):
        scale = np.abs(ours).max()
        np.testing.assert_allclose(
            np.asarray(ours)[:30] / scale, np.asarray(theirs)[:30] / scale, atol=1e-4, err_msg=name
        )


def test_discs_that_cross_change_places_where_they_cross(study, sphere):
    """Left of the crossing the red disc is in front, right of it the green one; by centres red is in front of all."""
    tilt = np.array([[np.sin(0.5), 0, np.cos(0.5)], [-np.sin(0.5), 0, np.cos(0.5)]])
    means = np.array([[0, 0, -1e-3], [0, 0, 1e-3]])
    splats = splats_of(study, means, tilt, np.eye(3)[:2], opacity=0.99)
    viewmat = jnp.eye(4).at[2, 3].set(4.0)
    middle = sphere.SIZE // 2
    both = {
        draw: np.asarray(draw(splats, viewmat, filtered=study.MIP).colors)[middle]
        for draw in (study.in_tiles, study.by_pixel)
    }
    near, far = (both[study.by_pixel][middle + side] for side in (2, -3))
    assert (near[0] > 3 * near[1]) != (far[0] > 3 * far[1]), (near, far)
    assert all(both[study.in_tiles][middle + side][0] > 3 * both[study.in_tiles][middle + side][1] for side in (2, -3))
