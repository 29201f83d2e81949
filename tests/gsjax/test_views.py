import jax.numpy as jnp
import numpy as np
import pytest
from tolerances import assert_close

from gsjax import views
from gsjax.errors import InputError
from gsjax.render import View
from gsjax.scene import Pixels, frame_of, with_pixels
from gsjax.training import losses

RNG = np.random.default_rng(0)
BLACK, WHITE = jnp.zeros(3, jnp.float32), jnp.ones(3, jnp.float32)


def frame(width, height, *, matte=None, valid=None, name="a.png"):
    K = np.array([[40.0, 0, 0.5 * width + 1], [0, 44.0, 0.5 * height - 1], [0, 0, 1]], np.float32)
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[:3, 3] = RNG.normal(size=3)
    image = RNG.integers(0, 256, (height, width, 3), dtype=np.uint8)
    return frame_of(name, viewmat, K, Pixels(image, matte, valid))


def test_mixed_sizes_are_padded_right_and_below_and_the_padding_is_invalid():
    frames = (frame(12, 6), frame(8, 10))
    data = views.stack_views(frames)
    assert data.num_views == 2 and data.size == (12, 10)
    assert_close(data.images[0, :6], frames[0].pixels().image)
    assert_close(data.images[1, :, :8], frames[1].pixels().image)
    expected = np.zeros((2, 10, 12), bool)
    expected[0, :6], expected[1, :, :8] = True, True
    assert_close(data.valid, expected)
    assert_close(data.viewmats[1], frames[1].viewmat)
    assert_close(data.Ks[0], frames[0].K)
    assert data.mattes is None


def test_the_loss_of_a_padded_photo_is_that_of_the_photo_alone():
    small, large = frame(12, 14), frame(16, 18)
    rendered = RNG.random((18, 16, 3)).astype(np.float32)

    def terms(batch, colors):
        view = View(jnp.asarray(colors), jnp.asarray(colors[..., 0]), None, None)
        return losses.l1(None, view, batch), losses.dssim(None, view, batch)

    alone = views.batch(views.stack_views((small,)), 0, BLACK)
    padded = views.batch(views.stack_views((large, small)), 1, BLACK)
    assert padded.image.shape == (18, 16, 3)
    assert_close(terms(padded, rendered), terms(alone, rendered[:14, :12]))


def test_reduction_is_the_mean_over_blocks_and_scales_the_camera():
    photo = frame(9, 6)
    data = views.stack_views((photo,), scale=2)
    blocks = photo.pixels().image[:6, :8].astype(np.float64).reshape(3, 2, 4, 2, 3).mean((1, 3))
    assert data.size == (4, 3)
    assert_close(data.images[0], np.rint(blocks).astype(np.uint8))
    assert_close(data.Ks[0], np.diag([0.5, 0.5, 1]) @ photo.K)
    assert bool(data.valid.all())


def test_a_reduction_that_leaves_no_pixel_is_one_line():
    with pytest.raises(InputError, match="image_scale=8: nothing is left of a photo of 9x6 pixels"):
        views.stack_views((frame(9, 6),), scale=8)


def test_what_transparent_or_invalid_pixels_hold_does_not_bleed_into_a_reduced_photo():
    coverage = np.zeros((4, 4), np.uint8)
    coverage[:, 1] = 255
    coverage[:2, 0] = 51
    for field in ("matte", "valid"):
        photo = frame(4, 4, **{field: coverage})
        shown = photo.pixels()
        poisoned = with_pixels(photo, shown._replace(image=np.where(coverage[..., None] > 0, shown.image, 255)))
        assert_close(
            views.stack_views((poisoned,), scale=2).images[:, :, :1],
            views.stack_views((photo,), scale=2).images[:, :, :1],
        )
    weights = coverage[:2, :2, None] / 255
    expected = np.rint((photo.image[:2, :2] * weights).sum((0, 1)) / weights.sum((0, 1)))
    assert_close(views.stack_views((photo,), scale=2).images[0, 0, 0], expected.astype(np.uint8))


def test_mattes_lay_the_photo_over_the_background():
    matte = RNG.integers(0, 256, (5, 7), dtype=np.uint8)
    photo = frame(7, 5, matte=matte)
    background = np.array([0.2, 0.5, 0.9])
    batch = views.batch(views.stack_views((photo,)), 0, jnp.asarray(background, jnp.float32))
    a = matte[..., None] / 255
    assert_close(batch.image, photo.image / 255 * a + (1 - a) * background)
    assert_close(batch.matte, matte / 255)


def test_a_photo_without_a_matte_among_others_is_opaque():
    photos = (frame(7, 5, matte=np.zeros((5, 7), np.uint8)), frame(7, 5))
    data = views.stack_views(photos)
    assert_close(views.batch(data, 0, WHITE).image, np.ones((5, 7, 3)))
    assert_close(views.batch(data, 1, WHITE).image, photos[1].pixels().image / 255)


@pytest.mark.parametrize("scale", [1, 2])
def test_masks_decide_what_is_valid(scale):
    mask = np.zeros((4, 6), np.uint8)
    mask[:, :2], mask[0, 2:4] = 255, 255  # whole, and half a block
    data = views.stack_views((frame(6, 4, valid=mask),), scale=scale)
    majority = mask > 0 if scale == 1 else np.array([[1, 1, 0], [1, 0, 0]], bool)
    assert_close(data.valid[0], majority)


def test_normal_maps_are_padded_with_nothing_and_read_back_in_float32():
    data = views.stack_views((frame(6, 4), frame(4, 3)))
    maps = [RNG.normal(size=(4, 6, 3)), RNG.normal(size=(3, 4, 3))]
    batch = views.batch(views.with_normals(data, maps), 1, BLACK)
    assert batch.normals.dtype == jnp.float32
    assert_close(batch.normals[:3, :4], maps[1].astype(np.float16))
    assert_close(batch.normals[3:], np.zeros((1, 6, 3)))
    assert views.batch(data, 1, BLACK).normals is None


def test_the_camera_of_a_view_has_the_padded_size():
    data = views.stack_views((frame(6, 4), frame(4, 3)))
    camera = views.camera(data, 1)
    assert (camera.width, camera.height) == (6, 4)
    assert_close((camera.viewmat, camera.K), (data.viewmats[1], data.Ks[1]))
