import math
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from gsjax.errors import InputError
from gsjax.io.images import write_image
from gsjax.io.lenses import Lens, check_lens, pinhole_views, resize_lens
from gsjax.io.photos import Photo
from gsjax.io.scenes import with_image_circles

WIDTH, HEIGHT = 160, 120
CENTER = (78.0, 61.5)
# The distortion that follows the focal lengths and the principal point, for every model that has some.
DISTORTION = {
    "SIMPLE_RADIAL": (0.05,),
    "RADIAL": (-0.1, 0.02),
    "OPENCV": (-0.1, 0.02, 0.002, -0.001),
    "FULL_OPENCV": (-0.1, 0.02, 0.002, -0.001, 0.01, 0.02, 0.0, 0.0),
    "FOV": (0.6,),
    "SIMPLE_DIVISION": (-0.08,),
    "DIVISION": (-0.08,),
    "EUCM": (0.5, 1.1),
    "SIMPLE_FISHEYE": (),
    "FISHEYE": (),
    "SIMPLE_RADIAL_FISHEYE": (0.03,),
    "RADIAL_FISHEYE": (0.03, -0.01),
    "OPENCV_FISHEYE": (0.03, -0.01, 0.002, 0.0),
    "THIN_PRISM_FISHEYE": (0.03, -0.01, 0.002, 0.001, 0.0, 0.0, 0.001, 0.002),
    "RAD_TAN_THIN_PRISM_FISHEYE": (0.03, -0.01, 0.0, 0.0, 0.0, 0.0, 0.001, 0.001, 0.001, 0.0, 0.001, 0.0),
}
ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_DIVISION", "SIMPLE_FISHEYE", "SIMPLE_RADIAL_FISHEYE")
ONE_FOCAL += ("RADIAL_FISHEYE",)


def lens_of(model: str, focal: float = 110.0) -> Lens:
    focals = (focal,) if model in ONE_FOCAL else (focal, focal + 1)
    return Lens(model, WIDTH, HEIGHT, (*focals, *CENTER, *DISTORTION.get(model, ())))


def pattern(rays: np.ndarray) -> np.ndarray:
    """A smooth picture of the directions, 0..1."""
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return (0.5 + 0.5 * np.sin(9 * unit[..., 0] + 3) * np.cos(7 * unit[..., 1] + 2 * unit[..., 2])).astype(np.float32)


def centres(width: int, height: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), -1)


def photo_through(lens: Lens) -> np.ndarray:
    """The pattern as the lens records it, by pycolmap's inverse of the model: the other way round than our map."""
    camera = pycolmap.Camera(model=lens.model, width=lens.width, height=lens.height, params=list(lens.params))
    pixels = centres(lens.width, lens.height).reshape(-1, 2)
    rays = np.array([camera.cam_ray_from_img(pixel) for pixel in pixels])
    return pattern(rays).reshape(lens.height, lens.width)


def pinhole_rays(view) -> np.ndarray:
    pixels = centres(view.width, view.height)
    homogeneous = np.concatenate([pixels, np.ones_like(pixels[..., :1])], -1)
    return homogeneous @ np.linalg.inv(view.K).T @ view.rotation


@pytest.mark.parametrize("model", [n for n in pycolmap.CameraModelId.__members__ if n != "INVALID"])
def test_every_model_becomes_the_pinhole_picture_of_the_same_directions(model):
    lens = Lens(model, 160, 80, (160.0, 80.0)) if model == "EQUIRECTANGULAR" else lens_of(model)
    photo = photo_through(lens)
    views = pinhole_views(lens)
    assert len(views) == (6 if model == "EQUIRECTANGULAR" else 1)
    for view in views:
        picture = view.warp(photo)
        assert picture.shape == (view.height, view.width)
        error = np.abs(picture - pattern(pinhole_rays(view)))
        assert view.valid is None
        # Bilinear reading of a pattern this smooth: a map half a pixel off shows 0.03. A panorama of 160 pixels is
        # coarse, and its seam is read half a pixel off.
        assert np.quantile(error, 0.99) < (0.06 if model == "EQUIRECTANGULAR" else 3e-3)
        assert view.width * view.height > 0.8 * WIDTH * HEIGHT or model == "EQUIRECTANGULAR"


@pytest.mark.parametrize("size", [(WIDTH // 2, HEIGHT // 2), (41, 29)])
@pytest.mark.parametrize("model", [*ONE_FOCAL, "FULL_OPENCV", "EQUIRECTANGULAR"])
def test_a_resized_lens_records_every_ray_at_the_resized_place(model, size):
    lens = Lens(model, 160, 120, (160.0, 120.0)) if model == "EQUIRECTANGULAR" else lens_of(model)
    factors = np.array(size) / [lens.width, lens.height]
    rays = np.random.default_rng(0).uniform([-0.5, -0.4, 1], [0.5, 0.4, 1], (50, 3))

    def recorded(lens):
        camera = pycolmap.Camera(model=lens.model, width=lens.width, height=lens.height, params=list(lens.params))
        return np.asarray(camera.img_from_cam(rays))

    smaller = resize_lens(lens, *size)
    assert (smaller.width, smaller.height) == size
    np.testing.assert_allclose(recorded(smaller), recorded(lens) * factors, rtol=1e-12, atol=1e-10)
    if factors[0] == factors[1]:
        assert smaller.model == model


def test_picture_beyond_the_fold_of_a_polynomial_is_not_valid():
    lens = Lens("SIMPLE_RADIAL", WIDTH, HEIGHT, (60.0, *CENTER, -0.5))
    (view,) = pinhole_views(lens)
    radius = np.linalg.norm((centres(view.width, view.height) - view.K[:2, 2]) / 60.0, axis=-1)
    fold = np.sqrt(1 / (3 * 0.5))  # d/dr (r - 0.5 r^3) = 0
    assert view.valid is not None
    assert not view.valid[radius > fold + 0.03].any()
    assert view.valid[radius < fold - 0.03].all()


@pytest.mark.parametrize("params", [(-3.0, 5.0, 5.0), (np.nan, 5.0, 5.0), (3.0, np.inf, 5.0), (0.15, 5.0, 5.0)])
def test_unusable_numbers_are_refused(params, tmp_path):
    with pytest.raises(InputError, match=r"cameras.bin \(SIMPLE_PINHOLE 10x10 with .* has a"):
        check_lens(Lens("SIMPLE_PINHOLE", 10, 10, params), tmp_path / "cameras.bin")


@pytest.mark.parametrize("model", ["OPENCV_FISHEYE", "SIMPLE_FISHEYE"])
def test_a_wide_fisheye_photo_is_faces_that_lose_nothing_of_it(model):
    """Every pixel of the photo, but for rounding at the seams, is shown by exactly one face, where its ray lies."""
    lens = lens_of(model, focal=75.0)
    camera = pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=list(lens.params))
    photo = photo_through(lens)
    views = pinhole_views(lens)
    assert {view.suffix for view in views} == {"_front", "_right", "_left", "_up", "_down"}
    for view in views:
        is_valid = np.ones((view.height, view.width), bool) if view.valid is None else view.valid > 0
        error = np.abs(view.warp(photo) - pattern(pinhole_rays(view)))[is_valid]
        assert np.quantile(error, 0.98) < 0.02
    rays = np.asarray(camera.cam_ray_from_img(image_points=centres(WIDTH, HEIGHT).reshape(-1, 2)))
    num_faces = np.zeros(len(rays), int)
    for view in views:
        x, y, z = view.rotation @ rays.T
        at = np.stack([x, y]) / np.where(z > 1e-6, z, np.inf) * np.diag(view.K)[:2, None] + view.K[:2, 2:]
        column, row = np.clip(at, 0, [[view.width - 1], [view.height - 1]]).astype(int)
        within = (z > 1e-6) & (at >= 0).all(0) & (at < [[view.width], [view.height]]).all(0)
        num_faces += within & (True if view.valid is None else view.valid[row, column] > 0)
    assert (num_faces == 1).mean() > 0.98
    assert num_faces.max() <= 2 and np.arccos(rays[:, 2].min()) > np.radians(60)


CIRCLE_WIDTH, CIRCLE_HEIGHT, X, Y, RADIUS = 240, 200, 121.0, 98.0, 90.0
FOCAL = RADIUS / np.radians(75)  # a clip-on lens whose circle shows 150 degrees
CLIP_ON = Lens("OPENCV_FISHEYE", CIRCLE_WIDTH, CIRCLE_HEIGHT, (FOCAL, FOCAL, X, Y, 0, 0, 0, 0))
RADII = np.hypot(np.arange(CIRCLE_WIDTH) + 0.5 - X, (np.arange(CIRCLE_HEIGHT) + 0.5 - Y)[:, None])
LIT = np.random.default_rng(0).integers(40, 256, (CIRCLE_HEIGHT, CIRCLE_WIDTH, 3), dtype=np.uint8)
NOISE = np.random.default_rng(1).integers(0, 12, LIT.shape, dtype=np.uint8)


def reaches(folder: Path, *pictures: np.ndarray, lens: Lens = CLIP_ON) -> set[float]:
    photos = []
    for index, picture in enumerate(pictures):
        write_image(folder / f"{index}.png", picture)
        photos.append(Photo(f"{index}.png", folder / f"{index}.png", np.eye(4), lens))
    return {photo.lens.reach for photo in with_image_circles(photos)}


def in_circle(picture: np.ndarray) -> np.ndarray:
    return np.where(RADII[..., None] < RADIUS, picture, NOISE)


def test_what_lies_beyond_the_circle_is_in_no_face(tmp_path):
    night = in_circle(LIT // 40)
    stray = in_circle(LIT)
    stray[3, 5] = 255
    [reach] = reaches(tmp_path, night, stray, night)
    assert reach * CIRCLE_WIDTH == pytest.approx(RADIUS - 2, abs=1)
    for factor in (1, 2):
        lens = resize_lens(Lens(**{**vars(CLIP_ON), "reach": reach}), factor * CIRCLE_WIDTH, factor * CIRCLE_HEIGHT)
        faces = pinhole_views(lens)
        assert {face.suffix for face in faces} == {"_front", "_right", "_left", "_up", "_down"}
        for face in faces:
            valid = np.ones((face.height, face.width), bool) if face.valid is None else face.valid > 0
            assert face.source_xy is not None and valid.any()
            assert np.hypot(*np.moveaxis(face.source_xy[valid] - factor * np.array([X, Y]), -1, 0)).max() < factor * 90


@pytest.mark.parametrize("picture", [LIT, NOISE, np.where(RADII[..., None] < 30, LIT, NOISE)])
def test_photos_that_are_bright_to_their_corners_or_all_dark_tell_no_circle(tmp_path, picture):
    assert reaches(tmp_path, picture) == {math.inf}
