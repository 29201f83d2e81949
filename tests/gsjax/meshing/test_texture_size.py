"""How many pixels see a triangle, against the rays of the pixels, and how large a texture that makes."""

import numpy as np
from meshes import mesh_of, square
from tolerances import assert_close

from gsjax.meshing.pictures import depth_of_mesh
from gsjax.meshing.ray_queries import ray_caster
from gsjax.meshing.texture import pixels_of_faces, texture_side
from gsjax.scene.cameras import Camera
from gsjax.scene.meshes import Mesh

WIDTH, HEIGHT, FOCAL = 320, 240, 260.0
BOUNDS = {"least": 64, "most": 4096}
FILLED, STEP = 0.5, 256  # charts fill half of a square, whose side is a multiple of 256 texels


def camera(distance: float, turn: float = 0.0, size: float = 1.0) -> Camera:
    """Looks from z = distance at the origin, turned by an angle about the y axis; `size` times as many pixels."""
    c, s = np.cos(turn), np.sin(turn)
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[:3, :3] = np.diag([1, -1, -1]) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    viewmat[2, 3] = distance
    K = np.array([[FOCAL * size, 0, WIDTH * size / 2], [0, 1.2 * FOCAL * size, HEIGHT * size / 2], [0, 0, 1]])
    return Camera(viewmat, K.astype(np.float32), round(WIDTH * size), round(HEIGHT * size))


def plane(per_side: int) -> Mesh:
    """[-1, 1] squared in the plane z = 0, facing up."""
    return square(per_side, -1.0, 1.0)


def test_pixels_of_a_plane_are_those_whose_rays_meet_it():
    wall, view = plane(40), camera(4.0, 1.1)
    met = np.count_nonzero(depth_of_mesh(ray_caster(wall), view))
    assert_close(pixels_of_faces(wall, view).sum(), met, rtol=0.01, why="the plane's outline is 500 pixels long")


def test_the_side_follows_the_view_that_sees_most_and_the_bounds_hold():
    wall, near, far = plane(20), camera(4.0, size=4.0), camera(16.0)
    expected = np.sqrt(4 * pixels_of_faces(wall, near).sum() / FILLED)  # four texels a pixel
    side = texture_side(wall, [far, near, far], **BOUNDS)
    assert 0 <= side - expected < STEP and side % STEP == 0
    assert texture_side(wall, [far], **BOUNDS) < side
    small_triangles_side = texture_side(plane(300), [camera(100.0)], **BOUNDS)
    assert 0 <= small_triangles_side - np.sqrt(16 * 180_000 / FILLED) < STEP
    assert texture_side(wall, [camera(4.0, size=20.0)], **BOUNDS) == BOUNDS["most"]
    assert texture_side(mesh_of(np.zeros((0, 3)), np.zeros((0, 3))), [far], **BOUNDS) == BOUNDS["least"]
