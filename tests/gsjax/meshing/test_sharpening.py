"""A plane with a pattern finer than two pixels' blur, seen from straight above: every pixel's mean is known."""

from dataclasses import replace

import jax.numpy as jnp
import meshes
import numpy as np
import pytest

from gsjax.meshing import sharpening
from gsjax.meshing.atlas import Atlas, TexturedMesh
from gsjax.meshing.sharpening import sharpened
from gsjax.meshing.texture import texture_mesh
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera

PIXELS, TEXELS, FOCAL, AWAY = 40, 80, 40.0, 1.0  # The square of side 1 fills the image: a pixel has two texels a side.
WAVES = 8  # across the square: five pixels each


def square() -> TexturedMesh:
    mesh = meshes.turned(meshes.square(1, -0.5, 0.5))
    atlas = Atlas(mesh.vertices[:, :2] + 0.5, np.arange(4, dtype=np.int32), mesh.faces, TEXELS, 1)
    return TexturedMesh(mesh, atlas, np.zeros((TEXELS, TEXELS, 3), np.uint8))


def view() -> Camera:
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[2, 3] = AWAY
    K = np.float32([[FOCAL, 0, PIXELS / 2], [0, FOCAL, PIXELS / 2], [0, 0, 1]])
    return Camera(jnp.asarray(viewmat), jnp.asarray(K), PIXELS, PIXELS)


def means(count: int) -> np.ndarray:
    """`[count, count, 3]` means of 0.5 + 0.4 sin(2 pi WAVES x) sin(2 pi WAVES y) over cells, by its integral."""
    edges = np.linspace(0, 1, count + 1)
    along = -np.diff(np.cos(2 * np.pi * WAVES * edges)) / (2 * np.pi * WAVES) * count
    return np.repeat((0.5 + 0.4 * np.outer(along, along))[..., None], 3, axis=-1)


def photo(colors: np.ndarray, alphas: float | np.ndarray = 1.0) -> Picture:
    alphas = np.broadcast_to(np.float32(alphas), (PIXELS, PIXELS))
    return Picture((colors * alphas[..., None]).astype(np.float32), np.full((PIXELS, PIXELS), AWAY, np.float32), alphas)


def painted(colors: np.ndarray) -> TexturedMesh:
    textured = square()
    return TexturedMesh(textured.mesh, textured.atlas, np.rint(255 * colors).astype(np.uint8))


def error(textured: TexturedMesh) -> float:
    inner = slice(8, -8)
    return float(np.abs(textured.texture[inner, inner] / 255 - means(TEXELS)[inner, inner]).mean())


@pytest.mark.parametrize("most_pixels", [sharpening.MOST_PIXELS, 0])
def test_rounds_take_back_half_of_the_blur_and_no_more_than_pixels_say(monkeypatch, most_pixels):
    monkeypatch.setattr(sharpening, "MOST_PIXELS", most_pixels)
    plain = square()
    blurred, _ = texture_mesh(
        plain.mesh, [view()], [photo(means(PIXELS))], size=TEXELS, unwrap=lambda mesh, size: plain.atlas
    )
    once = sharpened(blurred, [view()], [photo(means(PIXELS))])
    twice = sharpened(once, [view()], [photo(means(PIXELS))])
    # A texel lies under one pixel alone here, so that the first round solves all that the pixels ask for.
    assert error(twice) <= error(once) < 0.6 * error(blurred)


def test_pixels_that_say_nothing_change_nothing():
    grey = painted(np.full((TEXELS, TEXELS, 3), 0.4))
    white = np.ones((PIXELS, PIXELS, 3))
    masked = photo(white, 0.0)
    hazy = photo(white)._replace(depth=np.full((PIXELS, PIXELS), 0.8 * AWAY, np.float32))
    for nothing in (masked, hazy):
        np.testing.assert_array_equal(sharpened(grey, [view()], [nothing]).texture, grey.texture)
    away = replace(view(), viewmat=view().viewmat.at[2, 3].set(-AWAY))  # The square lies behind it.
    np.testing.assert_array_equal(sharpened(grey, [away], [photo(white)]).texture, grey.texture)
