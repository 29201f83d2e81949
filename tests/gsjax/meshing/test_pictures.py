import jax.numpy as jnp
import meshes
import numpy as np
import pytest
from meshes import ball, turned

from gsjax.meshing.atlas import Atlas, TexturedMesh
from gsjax.meshing.cleaning import concatenate_meshes
from gsjax.meshing.pictures import depth_of_mesh, headlight, render_mesh, smooth_pictures, texture_colors, vertex_colors
from gsjax.meshing.ray_queries import front_faces_only, ray_caster
from gsjax.scene.cameras import Camera
from gsjax.scene.meshes import Mesh

K = np.array([[40.0, 0, 17], [0, 50.0, 14], [0, 0, 1]])
WIDTH, HEIGHT = 36, 30
AT_ORIGIN = Camera(np.eye(4), K, WIDTH, HEIGHT)


def square(z, half=0.49):
    """A square at camera z that faces the camera (towards -z)."""
    return turned(meshes.square(1, -half, half, height=z, color=(200, 100, 50)))


def covered(z, half=0.49):
    """Pixels whose centres the square covers, by projecting them back."""
    x, y = np.meshgrid((np.arange(WIDTH) + 0.5 - 17) / 40 * z, (np.arange(HEIGHT) + 0.5 - 14) / 50 * z)
    return (np.abs(x) < half) & (np.abs(y) < half)


def test_a_square_covers_its_pixels_at_its_depth_and_the_nearer_of_two_is_seen():
    near, far = square(1.5, half=0.2), square(3.0, half=1.0)
    both = concatenate_meshes([near, far])
    depth = depth_of_mesh(ray_caster(both), AT_ORIGIN)
    np.testing.assert_array_equal(depth > 0, covered(3.0, 1.0))
    np.testing.assert_allclose(depth[covered(1.5, 0.2)], 1.5, rtol=1e-6)
    np.testing.assert_allclose(depth[covered(3.0, 1.0) & ~covered(1.5, 0.2)], 3.0, rtol=1e-6)


def test_back_faces_are_dark_red_in_every_shading():
    for shading in (vertex_colors, headlight):
        picture = render_mesh(turned(square(2.0)), AT_ORIGIN, shading=shading)
        assert np.all(picture[covered(2.0)] == [115, 0, 0])


def test_sphere_normals_against_the_closed_form_from_any_pose():
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = [[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]], [0.1, 0.2, 0.3]
    camera = Camera(viewmat, K, WIDTH, HEIGHT)
    mesh = ball(4, center=viewmat[:3, :3].T @ ([0, 0, 4] - viewmat[:3, 3]))
    picture = render_mesh(mesh, camera, shading=lambda hits: (hits.normals + 1) / 2).astype(float)
    depth = depth_of_mesh(ray_caster(mesh), camera)
    rows, columns = np.nonzero(depth)
    points = (
        np.stack([(columns + 0.5 - 17) / 40, (rows + 0.5 - 14) / 50, np.ones(len(rows))], -1)
        * depth[rows, columns, None]
    )
    normals = points - [0, 0, 4]
    assert len(rows) == pytest.approx(np.pi * (1 / np.sqrt(15)) ** 2 * 40 * 50, rel=0.05)
    assert np.abs(picture[rows, columns] - (normals + 1) * 127.5).mean() < 3


def test_smooth_pictures_mix_edges_by_the_share_that_is_covered():
    half = 0.3  # 40 / 2 * 0.3 = 6 pixels to either side, and 7.5 up and down.
    mesh = square(2.0, half)
    (picture,) = smooth_pictures(mesh, [Camera(jnp.eye(4), jnp.asarray(K, jnp.float32), WIDTH, HEIGHT)])
    rows = np.clip(np.minimum(np.arange(HEIGHT) + 1, 21.5) - np.maximum(np.arange(HEIGHT), 6.5), 0, 1)
    columns = np.clip(np.minimum(np.arange(WIDTH) + 1, 23) - np.maximum(np.arange(WIDTH), 11), 0, 1)
    share = rows[:, None] * columns[None]
    assert set(np.unique(share)) == {0, 0.5, 1}
    np.testing.assert_allclose(picture.alphas, share, atol=1e-6)
    np.testing.assert_allclose(picture.colors, share[..., None] * np.array([200, 100, 50]) / 255, atol=1e-6)
    np.testing.assert_allclose(picture.depth, np.where(share > 0, 2, 0), atol=1e-5)


def test_rays_pass_back_faces_and_stop_at_the_first_front_face():
    """Four sheets in a row, facing away, away, towards, towards: the third is met; from behind, the second."""
    sheets = [np.array([[-1, -1, z], [1, -1, z], [0, 2, z]], np.float32) for z in (1.0, 2.0, 3.0, 4.0)]
    faces = np.arange(12, dtype=np.int32).reshape(4, 3)
    faces[2:] = faces[2:, ::-1]
    mesh = Mesh(np.concatenate(sheets), faces, np.zeros((12, 3), np.uint8))
    cast = front_faces_only(mesh, ray_caster(mesh))
    origins = np.array([[0, 0, 0.0], [0.1, 0, 9.0], [0, 0, 3.5], [50, 0, 0]])
    directions = np.array([[0, 0, 2.0], [0, 0, -1.0], [0, 0, -1.0], [0, 0, 1.0]])
    hits = cast(origins, directions)
    np.testing.assert_allclose(hits.distances, [1.5, 7.0, 1.5, np.inf], rtol=1e-5)
    assert hits.faces[:3].tolist() == [2, 1, 1]
    np.testing.assert_allclose(hits.barycentrics.sum(axis=1), 1, rtol=1e-6)


def test_a_texture_is_drawn_where_its_places_say():
    mesh = square(2.0, half=1.0)
    uvs = (mesh.vertices[:, :2] + 1) / 2  # y down, as the camera's
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 256, (8, 8, 3), dtype=np.uint8)
    textured = TexturedMesh(mesh, Atlas(uvs, np.arange(4, dtype=np.int32), mesh.faces, 8, 1), texture)
    K = np.array([[8.0, 0, 4], [0, 8.0, 4], [0, 0, 1]])  # a pixel a texel
    picture = render_mesh(mesh, Camera(np.eye(4), K, 8, 8), shading=texture_colors(textured))
    assert np.abs(picture.astype(int) - texture).max() <= 1
    # Half a pixel to the right: halfway between two texels.
    K[0, 2] = 3.5
    picture = render_mesh(mesh, Camera(np.eye(4), K, 8, 8), shading=texture_colors(textured))
    halfway = (texture[:, :-1].astype(float) + texture[:, 1:]) / 2
    assert np.abs(picture[:, :-1] - halfway).max() <= 1
