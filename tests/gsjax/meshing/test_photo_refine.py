"""A mesh is refined on photos of a plane whose colours are a formula: the right vertices are known exactly."""

import numpy as np
import pytest
from meshes import square, turned

from gsjax.meshing.cleaning import concatenate_meshes
from gsjax.meshing.photo_refine import refine_on_photos
from gsjax.scene import Frame, Pixels, frame_of, with_pixels
from gsjax.scene.meshes import Mesh

SIZE, FOCAL = (124, 100), 75.0
PIXEL = 3 / FOCAL  # Scene units, from three units away.
EYES = [(x, y, -3.0) for x in (-1.0, 0.0, 1.0) for y in (-0.8, 0.8)]


def texture(x, y):
    """Colours of the plane z = 0, waves of five pixels and more."""
    waves = [np.sin(24 * x + 3 * y) * np.cos(17 * y), np.cos(21 * y - 6 * x), np.sin(12 * x) * np.sin(26 * y)]
    return 0.5 + 0.35 * np.stack(waves, axis=-1)


def photo(eye, colors=texture, gain=1.0) -> Frame:
    """What a camera at `eye` that looks along +z sees of the plane z = 0."""
    width, height = SIZE
    K = np.array([[FOCAL, 0, width / 2], [0, FOCAL, height / 2], [0, 0, 1]], np.float32)
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[:3, 3] = -np.asarray(eye)
    x, y = np.meshgrid((np.arange(width) + 0.5 - K[0, 2]) / FOCAL, (np.arange(height) + 0.5 - K[1, 2]) / FOCAL)
    image = np.clip(gain * colors(eye[0] - eye[2] * x, eye[1] - eye[2] * y), 0, 1)
    return frame_of(str(eye), viewmat, K, Pixels(np.round(255 * image).astype(np.uint8)))


def sheet(z, side=25) -> Mesh:
    """A square of 1.6 units at a height, which faces -z, where the cameras are."""
    return turned(square(side - 1, -0.8, 0.8, height=z))


@pytest.fixture(scope="module")
def frames():
    return [photo(eye) for eye in EYES]


@pytest.mark.parametrize("offset", [-1.0, 0.6])
def test_a_sheet_beside_the_plane_comes_to_lie_in_it(frames, offset):
    refined, report = refine_on_photos(sheet(offset * PIXEL), frames)
    away = np.abs(refined.vertices[:, 2]) / PIXEL
    # From 0.6 and 1 pixel. Photos are rounded to 8 bits and read bilinearly: a twentieth of a pixel stays.
    assert np.median(away) < 0.05 and np.quantile(away, 0.95) < 0.15
    np.testing.assert_allclose(refined.vertices[:, :2], sheet(0).vertices[:, :2], atol=1e-4)
    assert report["seen_share"] == 1.0
    assert report["moved_px"] == pytest.approx(abs(offset), abs=0.1)
    assert report["after"] < 0.5 * report["before"]


def test_photos_may_be_lighter_and_darker(frames):
    darker = [photo(eye, gain=gain) for eye, gain in zip(EYES, (1.0, 0.6, 0.8, 1.1, 0.9, 0.7), strict=True)]
    expected, _ = refine_on_photos(sheet(0.6 * PIXEL), frames)
    result, report = refine_on_photos(sheet(0.6 * PIXEL), darker)
    assert report["after"] < 0.3 < 10 < report["before"]  # Of 255: what rounding to 8 bits leaves.
    np.testing.assert_allclose(result.vertices, expected.vertices, atol=0.1 * PIXEL)


@pytest.mark.parametrize("kind", ["valid", "matte", "two photos", "one colour"])
def test_where_photos_say_nothing_a_sheet_stays(frames, kind):
    if kind == "two photos":
        photos = frames[:2]
    elif kind == "one colour":
        photos = [photo(eye, lambda x, y: np.full((*x.shape, 3), 0.4)) for eye in EYES]
    else:
        photos = [with_pixels(f, f.pixels()._replace(**{kind: np.zeros(SIZE[::-1], np.uint8)})) for f in frames]
    still, report = refine_on_photos(sheet(0.6 * PIXEL), photos)
    np.testing.assert_allclose(still.vertices, sheet(0.6 * PIXEL).vertices, atol=1e-6)
    assert report["before"] < 0.01
    if kind != "one colour":
        assert report == {"seen_share": 0.0, "moved_px": 0.0, "before": 0.0, "after": 0.0}


def test_a_hidden_sheet_stays(frames):
    front, back = sheet(0.0), sheet(0.5)
    both = concatenate_meshes([front, back])
    refined, report = refine_on_photos(both, frames)
    hidden = np.abs(back.vertices[:, :2]).max(axis=1) < 0.4  # From every camera the front is before these.
    np.testing.assert_array_equal(refined.vertices[front.num_vertices :][hidden], back.vertices[hidden])
    assert 0.5 <= report["seen_share"] < 0.8
