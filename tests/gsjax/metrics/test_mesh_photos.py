"""A mesh in photos beside the Gaussians that it came from: closed forms on one square."""

from dataclasses import replace

import meshes
import numpy as np
import pytest
from meshes import turned
from small_scenes import discs

from gsjax.effects.appearance import Appearance
from gsjax.gaussians import Gaussians
from gsjax.meshing.pictures import vertex_colors
from gsjax.metrics.mesh_photos import score_appearance
from gsjax.runs.photo_effects import PhotoEffects
from gsjax.scene import Pixels, frame_of
from gsjax.scene.meshes import Mesh

K = np.float32([[40, 0, 18], [0, 40, 16], [0, 0, 1]])
HEIGHT, WIDTH = 32, 36
GREY = 153  # 0.6 of the full range


def square(z: float) -> Mesh:
    """Faces the camera and covers 24 pixels along and 20 down, and half of one more on either side."""
    unit = turned(meshes.square(1, -1, 1, color=(GREY, GREY, GREY)))
    return replace(unit, vertices=unit.vertices * np.float32([12.5 * z / 40, 10.5 * z / 40, 0]) + np.float32([0, 0, z]))


def photo(*, level: float = 0.5, valid: np.ndarray | None = None):
    image = np.full((HEIGHT, WIDTH, 3), round(level * 255), np.uint8)
    return frame_of("held.png", np.eye(4, dtype=np.float32), K, Pixels(image, valid=valid), held_out=True)


@pytest.fixture
def nothing() -> Gaussians:
    """One Gaussian behind the camera: pictures of it show the background."""
    return discs([[0, 0, -5]], [0, 0, 1], 0.05)


def decibels(difference: float) -> float:
    return -20 * np.log10(abs(difference))


@pytest.mark.parametrize("valid", [None, np.tile(np.uint8([255] * (WIDTH // 2) + [0] * (WIDTH // 2)), (HEIGHT, 1))])
def test_both_are_scored_at_the_pixels_that_the_mesh_covers_and_no_mask(nothing, valid):
    scores = score_appearance(square(2.0), vertex_colors, nothing, (photo(valid=valid),), "black", PhotoEffects())
    level = round(0.5 * 255) / 255
    assert scores["mesh_psnr"] == pytest.approx(decibels(GREY / 255 - level), abs=1e-3)
    assert scores["covered_psnr"] == pytest.approx(decibels(level), abs=1e-3), "black where there are no Gaussians"
    assert scores["mesh_covers"] == pytest.approx(24 * 20 / (HEIGHT * WIDTH)), "half-covered pixels do not count"
    assert scores["mesh_ssim"] > scores["covered_ssim"]


def test_a_matte_has_the_same_background_for_both(nothing):
    image, matte = np.full((HEIGHT, WIDTH, 3), 51, np.uint8), np.full((HEIGHT, WIDTH), 102, np.uint8)
    frame = frame_of("held.png", np.eye(4, dtype=np.float32), K, Pixels(image, matte=matte), held_out=True)
    scores = score_appearance(square(2.0), vertex_colors, nothing, (frame,), "white", PhotoEffects())
    level = 0.2 * 0.4 + 0.6
    assert scores["mesh_psnr"] == pytest.approx(decibels(GREY / 255 - level), abs=1e-3)
    assert scores["covered_psnr"] == pytest.approx(decibels(1 - level), abs=1e-3)


def test_a_photo_is_compared_as_those_near_it_are_exposed(nothing):
    near = {"held.png": Appearance(log_gains=(np.log(0.5),) * 3, falloff=(0.0, 0.0))}
    effects = PhotoEffects(near_appearances=near, appearances=near)
    scores = score_appearance(square(2.0), vertex_colors, nothing, (photo(level=0.3),), "black", effects)
    names = {
        f"{of}_{score}{way}" for of in ("mesh", "covered") for score in ("psnr", "ssim") for way in ("", "_near_gains")
    }
    assert set(scores) == names | {"mesh_covers"}, "nothing that sees the answer"
    assert scores["mesh_psnr_near_gains"] > scores["mesh_psnr"] + 10


def test_photos_that_do_not_show_the_mesh_say_nothing(nothing):
    behind = np.diag(np.float32([-1, 1, -1, 1]))
    away = frame_of("away.png", behind, K, photo().pixels(), held_out=True)
    both = score_appearance(square(2.0), vertex_colors, nothing, (photo(), away), "black", PhotoEffects())
    one = score_appearance(square(2.0), vertex_colors, nothing, (photo(),), "black", PhotoEffects())
    assert both == {**one, "mesh_covers": pytest.approx(one["mesh_covers"] / 2)}
    none = score_appearance(square(2.0), vertex_colors, nothing, (away,), "black", PhotoEffects())
    assert none == {**dict.fromkeys(("mesh_psnr", "mesh_ssim", "covered_psnr", "covered_ssim")), "mesh_covers": 0}
    assert score_appearance(square(2.0), vertex_colors, nothing, (), "black", PhotoEffects()) == {}
