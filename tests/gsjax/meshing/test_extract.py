import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.meshing import regions
from gsjax.meshing.extract import cut_to_region, extract_mesh
from gsjax.meshing.level_set import level_set_poisson
from gsjax.meshing.pictures import depth_of_mesh
from gsjax.meshing.ray_queries import ray_caster
from gsjax.meshing.regions import Box, Region
from gsjax.scene.cameras import Camera
from gsjax.scene.meshes import Mesh, face_normals, signed_volume


def test_ball_becomes_one_closed_outward_sphere_and_an_empty_region_is_said(ball):
    near, far = Box((-2, -2, -2), (2, 2, 2)), Box((-9, -9, -9), (9, 9, 9))
    mesh, report = extract_mesh(
        ball.gaussians,
        *ball.views,
        method=level_set_poisson(most=12_000),
        regions=lambda _: regions.fixed_boxes(near, far),
    )
    properties = report["topology"]
    assert properties["components"] == 1
    assert properties["watertight"] and properties["oriented"] and not properties["inside_out"]
    assert "holds none of" in report["background"]["empty"]
    assert report["facing_share"] == 1
    assert signed_volume(mesh) == pytest.approx(4 / 3 * np.pi, rel=0.05)
    assert np.abs(mesh.colors.astype(int) - [255, 128, 0]).max() <= 2
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert np.abs(radii - 1).max() < 0.05
    outward = mesh.vertices[mesh.faces].mean(axis=1)
    assert np.mean(np.sum(face_normals(mesh) * outward, axis=-1) > 0.8) > 0.99


def test_two_regions_meet_without_a_crack_and_each_has_its_report(ball):
    near, far = Box((-2, -2, 0), (2, 2, 2)), Box((-2, -2, -2), (2, 2, 2))
    mesh, report = extract_mesh(
        ball.gaussians,
        *ball.views,
        method=level_set_poisson(most=8_000, depth=6),
        regions=lambda _: regions.fixed_boxes(near, far),
    )
    assert report["topology"]["components"] == 2
    assert report["foreground"]["points_seen"] + report["background"]["points_seen"] == report["seen"]["points"]
    # Rays from the middle of the ball meet the surface everywhere, the seam included.
    K = np.array([[32.0, 0, 32], [0, 32, 32], [0, 0, 1]])
    for axes in (np.eye(3), np.eye(3)[[1, 2, 0]], np.eye(3)[[2, 0, 1]]):
        for sign in (1, -1):
            viewmat = np.eye(4)
            viewmat[:3, :3] = np.diag([sign, 1, sign]) @ axes
            assert (depth_of_mesh(ray_caster(mesh), Camera(viewmat, K, 64, 64)) > 0).all()


def test_the_border_belongs_to_both_sides_of_a_cut():
    vertices = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [3, 0, 0], [20, 0, 0]])
    faces = np.int32([[0, 1, 2], [1, 3, 2], [3, 5, 4], [6, 6, 6]])
    mesh = Mesh(vertices, faces, np.zeros((7, 3), np.uint8))
    inner, outer = Box((-1, -1, -1), (1.2, 2, 1)), Box((-9, -9, -9), (9, 9, 9))
    np.testing.assert_array_equal(cut_to_region(mesh, Region(inner)).faces, faces[:2])
    np.testing.assert_array_equal(cut_to_region(mesh, Region(outer, without=inner)).faces, faces[1:3])


def test_pictures_without_owners_and_no_camera_are_one_line(ball):
    pictures = [picture._replace(owners=None) for picture in ball.views[1]]
    with pytest.raises(InputError, match=r"view 0: .* which Gaussian each pixel hit; .*with_owners=True"):
        extract_mesh(ball.gaussians, ball.cameras, pictures)
    with pytest.raises(InputError, match="no camera"):
        extract_mesh(ball.gaussians, [])
