import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tolerances import assert_close

from gsjax.errors import InputError
from gsjax.scene import Pixels, batches, frame_of, with_pixels

RNG = np.random.default_rng(0)
BLACK = jnp.zeros(3, jnp.float32)


def frame(width, height, *, matte=None, valid=None, name="a.png"):
    K = np.array([[40.0, 0, 0.5 * width + 1], [0, 44.0, 0.5 * height - 1], [0, 0, 1]], np.float32)
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[:3, 3] = RNG.normal(size=3)
    image = RNG.integers(0, 256, (height, width, 3), dtype=np.uint8)
    return frame_of(name, viewmat, K, Pixels(image, matte, valid))


def test_mixed_sizes_are_padded_right_and_below_and_the_padding_is_invalid():
    frames = (frame(12, 6), frame(8, 10))
    data = batches.read_batches(frames)
    assert data.num_views == 2 and data.size == (12, 10) and not data.has_mattes
    wide, tall = (batches.decode(target, BLACK) for target in data.views)
    assert_close(data.views[0].image[:6], frames[0].pixels().image)
    assert_close(data.views[1].image[:, :8], frames[1].pixels().image)
    assert_close(wide.valid, np.arange(10)[:, None] + np.zeros(12) < 6)
    assert_close(tall.valid, np.zeros((10, 1)) + np.arange(12) < 8)
    assert_close((tall.camera.viewmat, wide.camera.K), (frames[1].viewmat, frames[0].K))
    assert (tall.camera.width, tall.camera.height) == (12, 10)


def test_a_whole_photo_is_not_copied_and_a_matte_lays_it_over_the_background():
    matte = RNG.integers(0, 256, (5, 7), dtype=np.uint8)
    photo = frame(7, 5, matte=matte)
    (target,) = batches.read_batches((photo,)).views
    assert target.valid is None and target.normals is None and target.image is photo.pixels().image
    background = np.array([0.2, 0.5, 0.9])
    batch = batches.decode(target, jnp.asarray(background, jnp.float32))
    a = matte[..., None] / 255
    assert_close(batch.image, photo.pixels().image / 255 * a + (1 - a) * background)
    assert_close(batch.matte, matte / 255)


def test_reduction_is_the_mean_over_blocks_and_scales_the_camera():
    photo = frame(9, 6)
    data = batches.read_batches((photo,), scale=2)
    blocks = photo.pixels().image[:6, :8].astype(np.float64).reshape(3, 2, 4, 2, 3).mean((1, 3))
    assert data.size == (4, 3)
    assert_close(data.views[0].image, np.rint(blocks).astype(np.uint8))
    assert_close(data.views[0].camera.K, np.diag([0.5, 0.5, 1]) @ photo.K)
    assert bool(batches.decode(data.views[0], BLACK).valid.all())
    with pytest.raises(InputError, match="photos 8 times smaller: nothing is left of one of 9x6 pixels"):
        batches.read_batches((frame(9, 6),), scale=8)


def test_what_transparent_or_invalid_pixels_hold_does_not_bleed_into_a_reduced_photo():
    coverage = np.zeros((4, 4), np.uint8)
    coverage[:, 1] = 255
    coverage[:2, 0] = 51
    for field in ("matte", "valid"):
        photo = frame(4, 4, **{field: coverage})
        pixels = photo.pixels()
        poisoned = with_pixels(photo, pixels._replace(image=np.where(coverage[..., None] > 0, pixels.image, 255)))
        assert_close(
            batches.read_batches((poisoned,), scale=2).views[0].image[:, :1],
            batches.read_batches((photo,), scale=2).views[0].image[:, :1],
        )
    weights = coverage[:2, :2, None] / 255
    expected = np.rint((photo.pixels().image[:2, :2] * weights).sum((0, 1)) / weights.sum((0, 1)))
    assert_close(batches.read_batches((photo,), scale=2).views[0].image[0, 0], expected.astype(np.uint8))


@pytest.mark.parametrize("scale", [1, 2])
def test_masks_decide_what_is_valid(scale):
    mask = np.zeros((4, 6), np.uint8)
    mask[:, :2], mask[0, 2:4] = 255, 255  # whole, and half a block
    (target,) = batches.read_batches((frame(6, 4, valid=mask),), scale=scale).views
    majority = mask > 0 if scale == 1 else np.array([[1, 1, 0], [1, 0, 0]], bool)
    assert_close(batches.decode(target, BLACK).valid, majority)


def test_a_smaller_pixel_has_the_mean_of_its_normals_as_long_as_they_agree():
    data = batches.read_batches((frame(6, 4), frame(4, 3)), scale=2)
    maps = [np.zeros((4, 6, 3), np.int8), np.tile(np.int8([0, 0, -127]), (3, 4, 1))]
    maps[0][:2, :2], maps[0][:2, 2:4] = (-90, 0, -90), [[(0, 0, -127), (0, -127, 0)]] * 2
    one, other = (batches.decode(t, BLACK).normals for t in batches.with_normals(data, maps, 2).views)
    assert_close(one[0], np.array([[-90, 0, -90], [0, -64, -64], [0, 0, 0]]) / 127)
    assert_close(one[1], np.zeros((3, 3)))
    assert_close(other[:1, :2], np.tile([0, 0, -1.0], (1, 2, 1)))
    assert_close(other[1:], np.zeros((1, 3, 3)))


@pytest.mark.parametrize("room", [0, 1 << 20])
def test_targets_reach_the_device_with_the_same_bits_in_any_order(room):
    data = batches.read_batches(
        tuple(frame(6, 4, matte=RNG.integers(0, 256, (4, 6), dtype=np.uint8)) for _ in range(4))
    )
    view, order = batches.feed(data, room=room), [2, 0, 0, 3, 1, 2]
    for index, following in zip(order, [*order[1:], 1], strict=True):
        (fed,) = view([index], [following])
        assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(fed))
        jax.tree.map(np.testing.assert_array_equal, fed, data.views[index])
