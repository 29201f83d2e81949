"""Scores of held-out photos whose masks leave few pixels or none, against closed forms."""

import numpy as np
import pytest

from gsjax.metrics.photos import score_pictures
from gsjax.rendering.gallery import Picture
from gsjax.scene import Pixels, frame_of

HEIGHT, WIDTH = 12, 16
K = np.float32([[20, 0, 8], [0, 20, 6], [0, 0, 1]])
BLACK = np.zeros(3, np.float32)


def photo(name: str, level: int, valid: np.ndarray | None = None):
    """One grey everywhere."""
    image = np.full((HEIGHT, WIDTH, 3), level, np.uint8)
    return frame_of(name, np.eye(4, dtype=np.float32), K, Pixels(image, valid=valid), held_out=True)


def draw_black(cameras):
    for _ in cameras:
        colors = np.zeros((HEIGHT, WIDTH, 3), np.float32)
        yield Picture(colors, np.zeros((HEIGHT, WIDTH), np.float32), np.zeros((HEIGHT, WIDTH), np.float32))


def test_a_photo_without_a_valid_pixel_is_named_and_in_no_mean(capsys):
    half = np.zeros((HEIGHT, WIDTH), np.uint8)
    half[:, : WIDTH // 2] = 255
    hidden = np.full((HEIGHT, WIDTH), 127, np.uint8)  # 128 is the first value that is valid
    frames = (photo("a.png", 51), photo("hidden 1.png", 51, hidden), photo("b.png", 102, half))
    measures = {"mean": lambda image, target: float(np.mean(target))}
    scores = score_pictures(draw_black, frames, BLACK, measures=measures)
    expected = np.mean([-20 * np.log10(51 / 255), -20 * np.log10(102 / 255)])
    assert scores["psnr"] == pytest.approx(expected, abs=1e-4)
    assert scores["mean"] == pytest.approx(np.mean([51 / 255, 102 / 255 / 2]))
    assert scores["views"] == 2
    without = score_pictures(draw_black, frames[::2], BLACK, measures=measures)
    assert scores == without
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["not scored, because a mask covers every pixel: hidden 1.png"]
    nothing = score_pictures(draw_black, (photo("hidden 2.png", 51, hidden),), BLACK, measures=measures)
    assert nothing == {"psnr": None, "ssim": None, "mean": None, "views": 0}
    assert "hidden 2.png" in capsys.readouterr().err
