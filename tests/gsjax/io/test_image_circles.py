import math
from pathlib import Path

import numpy as np
import pytest

from gsjax.io.image_circles import with_image_circles
from gsjax.io.images import write_image
from gsjax.io.lenses import Lens, pinhole_views, resize_lens
from gsjax.io.photos import Photo

WIDTH, HEIGHT, X, Y, RADIUS = 240, 200, 121.0, 98.0, 90.0
FOCAL = RADIUS / np.radians(75)  # a clip-on lens whose circle shows 150 degrees
LENS = Lens("OPENCV_FISHEYE", WIDTH, HEIGHT, (FOCAL, FOCAL, X, Y, 0, 0, 0, 0))
RADII = np.hypot(np.arange(WIDTH) + 0.5 - X, (np.arange(HEIGHT) + 0.5 - Y)[:, None])
LIT = np.random.default_rng(0).integers(40, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
NOISE = np.random.default_rng(1).integers(0, 12, LIT.shape, dtype=np.uint8)


def reaches(folder: Path, *pictures: np.ndarray, lens: Lens = LENS) -> set[float]:
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
    assert reach * WIDTH == pytest.approx(RADIUS - 2, abs=1)
    for factor in (1, 2):
        lens = resize_lens(Lens(**{**vars(LENS), "reach": reach}), factor * WIDTH, factor * HEIGHT)
        faces = pinhole_views(lens)
        assert {face.suffix for face in faces} == {"_front", "_right", "_left", "_up", "_down"}
        for face in faces:
            valid = np.ones((face.height, face.width), bool) if face.valid is None else face.valid > 0
            assert face.source_xy is not None and valid.any()
            assert np.hypot(*np.moveaxis(face.source_xy[valid] - factor * np.array([X, Y]), -1, 0)).max() < factor * 90


@pytest.mark.parametrize("picture", [LIT, NOISE, np.where(RADII[..., None] < 30, LIT, NOISE)])
def test_photos_that_are_bright_to_their_corners_or_all_dark_tell_no_circle(tmp_path, picture):
    assert reaches(tmp_path, picture) == {math.inf}
