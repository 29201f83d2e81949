"""The term between two views: closed forms of two depth maps, and who is whose neighbour."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from small_scenes import camera_at
from tolerances import assert_close

from gsjax.rendering import Neighbor, View
from gsjax.scene import Pixels, batches, cameras, frame_of
from gsjax.scene.batches import Batch
from gsjax.scene.cameras import Camera
from gsjax.training import stepping
from gsjax.training.terms import multi_view

CAMERA = camera_at()
HEIGHT, WIDTH, FOCAL = 24, 32, 30.0
ALL = jnp.ones((HEIGHT, WIDTH), bool)


def beside(camera, right):
    """The camera, moved to its right."""
    return replace(camera, viewmat=camera.viewmat.at[0, 3].add(-right))


# Without LLVM's optimisations, as the session asks for, XLA's older emitters get one row of this gradient wrong.
@partial(jax.jit, compiler_options={"xla_backend_optimization_level": 3})
def _value_and_gradients(here, there, neighbor, valid):

    def term(here, there):
        view = View(None, None, here, None, neighbor=Neighbor(neighbor, there, None))
        return multi_view.multi_view(None, view, Batch(CAMERA, None, valid, None, None))

    return jax.value_and_grad(term, (0, 1))(here, there)


def value_and_gradients(here, there, neighbor, valid=ALL):
    """Of the term, to both depth maps; one signature, one compilation."""
    return _value_and_gradients(here, there, neighbor, valid)


def flat(depth):
    return jnp.full((HEIGHT, WIDTH), depth, jnp.float32)


def test_of_two_walls_at_different_depths_it_has_a_closed_form():
    # Into the neighbour by one disparity, back by the other.
    here, there, right = 1000.0, 950.0, 200.0
    off = FOCAL * right * (1 / there - 1 / here)
    assert 0.2 < off < 0.8
    value, (to_here, to_there) = value_and_gradients(flat(here), flat(there), beside(CAMERA, right))
    assert_close(value, off * np.exp(-off), rtol=1e-4, atol=0, why="pixels of float32")
    assert_close(np.sum(to_here), np.exp(-off) * FOCAL * right / here**2, rtol=1e-3, atol=0, why="pixels of float32")
    assert_close(np.sum(to_there), -np.exp(-off) * FOCAL * right / there**2, rtol=1e-3, atol=0, why="the same")
    leaves = np.asarray(to_here)[:, : int(FOCAL * right / here)]
    assert not leaves.any()  # what the neighbour does not show


def test_a_pixel_that_lands_a_pixel_away_met_something_else():
    there = np.full((HEIGHT, WIDTH), 3.8, np.float32)
    neighbor = beside(CAMERA, 0.8)
    expected, _ = value_and_gradients(flat(4.0), jnp.asarray(there), neighbor)
    there[8:16] = 2.0  # a bar before the wall
    value, (to_here, to_there) = value_and_gradients(flat(4.0), jnp.asarray(there), neighbor)
    assert_close(value, expected)
    for gradient in (np.asarray(to_here), np.asarray(to_there)):
        assert not gradient[8:16].any() and gradient[:7].any()


def test_a_plane_seen_from_two_sides_comes_home():
    # Inverse depth is linear in the pixel, depth is not: bilinear reading is off by its curvature within a pixel.
    there = camera_at((1.2, -0.5, 0.4), (0.0, 0.1, 4.0))
    normal = np.array([0.3, 0.2, -1.0])

    def depth(camera):
        rays = np.asarray(cameras.pixel_rays(camera), np.float64)
        turn, center = (np.asarray(f(camera), np.float64) for f in (cameras.rotation, cameras.center))
        return jnp.asarray((normal @ (np.array([0, 0, 4.0]) - center)) / (rays @ turn @ normal), jnp.float32)

    value, _ = value_and_gradients(depth(CAMERA), depth(there), there)
    assert float(value) < 1e-3
    shifted, _ = value_and_gradients(depth(CAMERA), 1.01 * depth(there), there)
    assert float(shifted) > 0.05  # a hundredth of 10 pixels of disparity, nearly


def test_there_and_back_has_the_gradient_of_finite_differences(x64):
    there = camera_at((1.2, -0.5, 0.4), (0.0, 0.1, 4.0))
    here, there = (jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), camera) for camera in (CAMERA, there))
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    depth = jnp.asarray(3.9 + 0.02 * columns - 0.03 * rows + 0.1 * np.sin(columns))

    def off(at, depth):
        _, distance, returns = multi_view._there_and_back(
            jnp.array([17.5, 12.5]), at, here, Neighbor(there, depth, None)
        )
        return jnp.where(returns, distance, jnp.nan)

    assert float(off(4.1, depth)) > 0.1
    check_grads(jax.jit(off), (jnp.array(4.1), depth), order=1, modes=["rev"])


AWAY = Camera(jnp.diag(jnp.array([-1, 1, -1, 1], jnp.float32)), CAMERA.K, WIDTH, HEIGHT)


@pytest.mark.parametrize(
    ("here", "there", "neighbor", "valid"),
    [
        (flat(4.0), flat(4.0), CAMERA, ALL),
        (flat(0.0), flat(0.0), beside(CAMERA, 0.8), ALL),
        (flat(4.0), flat(4.0), AWAY, ALL),
        (flat(4.0), flat(4.0), beside(CAMERA, 90.0), ALL),
        (flat(4.0), flat(3.8), beside(CAMERA, 0.8), ~ALL),
    ],
    ids=["itself", "nothing there", "behind the neighbour", "out of its sight", "masked"],
)
def test_where_nothing_can_be_compared_there_is_neither_value_nor_gradient(here, there, neighbor, valid):
    value, gradients = value_and_gradients(here, there, neighbor, valid)
    assert float(value) == 0
    assert all(not np.any(gradient) for gradient in gradients)


# --- what photos show

ASIDE = 0.8  # of the neighbour's camera, along x
AT = 4.0  # the wall


def painted(shift):
    """A photo of the wall by a camera so many pixels to the right."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    waves = np.sin(0.9 * (columns + shift)) + np.cos(0.7 * rows + 0.3 * (columns + shift))
    return jnp.asarray(np.repeat((0.5 + 0.2 * waves)[..., None], 3, -1), jnp.float32)


PHOTO, BESIDE = painted(0), painted(FOCAL * ASIDE / AT)


# As above.
@partial(jax.jit, compiler_options={"xla_backend_optimization_level": 3})
def _alike(here, there, neighbor, valid, photo, others):
    def term(here, there):
        view = View(None, None, here, None, neighbor=Neighbor(neighbor, there, None, others, ALL))
        return multi_view.photometric(None, view, Batch(CAMERA, photo, valid, None, None))

    return jax.value_and_grad(term, (0, 1))(here, there)


def alike(depth, *, neighbor=None, valid=ALL, photo=PHOTO, others=BESIDE):
    """The term and its gradients to both depth maps, which agree."""
    return _alike(flat(depth), flat(depth), neighbor or beside(CAMERA, ASIDE), valid, photo, others)


def test_two_photos_of_a_wall_are_alike_at_its_depth_and_pull_towards_it():
    value, (to_here, to_there) = alike(AT)
    assert float(value) < 5e-3  # the photo beside is read between pixels
    for depth in (0.94 * AT, 1.06 * AT):  # a third of a pixel
        off, (to_here, to_there) = alike(depth)
        assert float(off) > 4 * float(value)
        assert np.sign(np.sum(to_here)) == np.sign(depth - AT)
        assert not np.any(to_there)


def test_a_photo_beside_itself_asks_for_nothing_and_gain_and_offset_do_not_matter():
    value, gradients = alike(0.5 * AT, neighbor=CAMERA, others=PHOTO)
    assert_close(value, 0, atol=1e-6, why="variances of float32")
    for gradient in gradients:
        assert_close(gradient, np.zeros_like(gradient), atol=1e-8, why="places of float32")
    changed = alike(1.03 * AT, others=0.6 * BESIDE + 0.1)
    assert_close(changed, alike(1.03 * AT), rtol=2e-3, atol=2e-6, why="variances of float32")


def test_correlation_is_that_of_windows_in_float64(x64):
    rng = np.random.default_rng(0)
    a, b = rng.uniform(size=(2, HEIGHT, WIDTH))
    mask = rng.uniform(size=(HEIGHT, WIDTH)) < 0.8
    correlation = jax.jit(multi_view.correlation)(jnp.asarray(a), jnp.asarray(b), jnp.asarray(mask))
    offsets = np.arange(-5, 6)
    window = np.exp(-0.5 * (offsets / 1.5) ** 2)
    for y, x in ((0, 0), (5, 7), (12, 16), (HEIGHT - 1, 3)):
        rows, columns = np.clip(y + offsets, -1, HEIGHT), np.clip(x + offsets, -1, WIDTH)
        inside = ((rows >= 0) & (rows < HEIGHT))[:, None] & (columns >= 0) & (columns < WIDTH)
        at = np.ix_(rows % HEIGHT, columns % WIDTH)
        weights = np.outer(window, window) * inside * mask[at]
        weights /= weights.sum()
        apart = [image[at] - (weights * image[at]).sum() for image in (a, b)]
        squares = [(weights * each**2).sum() for each in apart]
        assert_close(correlation[y, x], (weights * apart[0] * apart[1]).sum() / np.sqrt(np.prod(squares)))


def test_photometric_has_the_gradient_of_finite_differences(x64):
    exact = partial(jax.tree.map, lambda x: jnp.asarray(x, jnp.float64) if x.dtype == jnp.float32 else x)
    # A little higher too: where rows land on rows, those at the border flicker between read and not read.
    lifted = replace(beside(CAMERA, ASIDE), viewmat=beside(CAMERA, ASIDE).viewmat.at[1, 3].add(0.03))
    photo, others, camera, neighbor = exact((PHOTO, BESIDE, CAMERA, lifted))
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    shape = jnp.asarray(0.01 * np.sin(0.5 * columns + 0.3 * rows))

    def term(depth):
        around = Neighbor(neighbor, jnp.full((HEIGHT, WIDTH), 1.031 * AT), None, others, ALL)
        view = View(None, None, depth + shape, None, neighbor=around)
        seen_at, off, is_valid = multi_view._journeys(view, Batch(camera, photo, ALL, None, None))
        read = jax.vmap(jax.vmap(partial(multi_view.sample_bilinear, jnp.mean(others, -1))))(seen_at)
        unlike = 1 - multi_view.correlation(jnp.mean(photo, -1), read, is_valid)
        return jnp.sum(jnp.where(is_valid, unlike, 0))

    check_grads(jax.jit(term), (jnp.array(1.0307 * AT),), order=1, modes=["rev"], eps=1e-6)


GREY = jnp.full((HEIGHT, WIDTH, 3), 0.5, jnp.float32)


@pytest.mark.parametrize(
    "case",
    [{"others": GREY}, {"photo": 0 * GREY, "others": 0 * GREY}, {"others": 1 - BESIDE}],
    ids=["plain neighbour", "black photos", "another thing"],
)
def test_photos_that_tell_nothing_ask_for_nothing(case):
    value, gradients = alike(1.03 * AT, **case)
    assert float(value) == 0
    assert all(not np.any(gradient) for gradient in gradients)


# --- neighbours

EYES = [(0.0, 0.0, 0.0), (0.7, 0.0, 0.0), (-0.2, 0.0, 1.4)]
LOOKS = [camera_at(eye, (0.0, 0.0, 4.0)) for eye in EYES]
DARK = Pixels(np.zeros((HEIGHT, WIDTH, 3), np.uint8))
PHOTOS = [frame_of(f"{i}.png", np.asarray(look.viewmat), np.asarray(look.K), DARK) for i, look in enumerate(LOOKS)]


def around(degrees):
    """Viewmats of cameras on a circle of radius 4 that look at its middle."""
    angles = np.radians(degrees)
    eyes = 4 * np.stack([np.sin(angles), 0 * angles, -np.cos(angles)], -1)
    return np.stack([cameras.look_at(eye, np.zeros(3), np.array([0.0, -1, 0])) for eye in eyes])


def test_neighbours_look_the_same_way_and_stand_apart():
    nearest = multi_view.nearest_views(around(np.array([0, 0.01, 10, 21, 45, 180])), extent=4.0)
    assert nearest.shape == (6, multi_view.NEAREST)
    # Twice the same place is no baseline; 45 degrees are too wide from everywhere but 21.
    assert [list(dict.fromkeys(row)) for row in nearest.tolist()] == [[2, 3], [2, 3], [1, 0, 3], [2, 1, 0, 4], [3], [5]]
    assert np.bincount(nearest[3]).tolist() == [2, 2, 2, 0, 2]  # repeated in turn
    near = multi_view.nearest_views(around(np.array([0, 10, 21])), extent=2.0)
    assert [set(row) for row in near.tolist()] == [{1}, {0, 2}, {1}]  # 21 degrees are 1.46 apart: over half of 2
    # To within thirty degrees.
    nearest = multi_view.nearest_views(around(np.array([0.0, 29.0, 59.5])), extent=20.0)
    assert [set(row) for row in nearest.tolist()] == [{1}, {0}, {2}]


def test_every_step_has_a_neighbour_of_its_view_beside_it():
    data = batches.with_photo_numbers(multi_view.with_neighbors(batches.read_batches(PHOTOS), 8.0))
    rows = multi_view.nearest_views(np.stack([target.camera.viewmat for target in data.views]), 8.0)
    target, beside = stepping.one_view(data, 0, 0.5), [set() for _ in PHOTOS]
    for step in range(90):
        here = target(step)
        assert int(here.photo) == stepping.view_order(0, step, len(PHOTOS))
        np.testing.assert_array_equal(here.neighbor.camera.viewmat, data.views[int(here.neighbor.photo)].camera.viewmat)
        beside[int(here.photo)].add(int(here.neighbor.photo))
    assert beside == [set(row.tolist()) for row in rows]
    # In a share of the steps: elsewhere a view is its own neighbour.
    neighbors = multi_view.with_neighbors(batches.read_batches(PHOTOS), 8.0, np.array([1.0, 0.4, 0.0])).neighbors
    others = neighbors != np.arange(3)[:, None]
    np.testing.assert_array_equal(others.mean(axis=1), [1, 3 / 8, 0])
    np.testing.assert_array_equal(neighbors[others], rows[others])
