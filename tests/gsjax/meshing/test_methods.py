"""The ways to a surface beside the level set: what each brings back from the same ball of discs."""

from functools import partial

import numpy as np
import pytest
from small_scenes import camera_at, cloud

from gsjax import gaussians as gs
from gsjax.errors import InputError
from gsjax.meshes import Mesh, face_normals, signed_volume
from gsjax.meshing import boxes, extract_mesh, methods
from gsjax.meshing.boxes import Box, Region
from gsjax.meshing.depth_points import LEAST_FACING, depth_poisson
from gsjax.meshing.marching_cubes import density_grid, marching_cubes
from gsjax.meshing.methods import centers_poisson
from gsjax.meshing.orientation import facing_share, orient_outward
from gsjax.meshing.tsdf import tsdf
from gsjax.normals.from_depth import smoothed_depth_normals
from gsjax.rendering.gallery import Picture

ALL = {
    "depth": depth_poisson(smoothed_depth_normals, 100_000),
    "centers": centers_poisson(),
    "tsdf": tsdf(voxel=0.06),
    "marching-cubes": marching_cubes(cell=0.06),
}


@pytest.fixture(scope="module", params=ALL)
def named_mesh(request, ball):
    return request.param, *extract_mesh(ball.gaussians, *ball.views, method=ALL[request.param])


def test_every_method_finds_the_ball(named_mesh):
    name, mesh, report = named_mesh
    # The grid shows both sides of discs that count as 0.6 cells thick: 0.036 sqrt(2 ln(3.2 / 0.3)) = 0.08 away.
    near = 0.11 if name == "marching-cubes" else 0.05
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert np.quantile(np.abs(radii - 1), 0.99) < near
    assert report["facing_share"] > 0.99
    assert report["topology"]["oriented"]
    assert np.abs(mesh.colors.astype(int) - ([128] * 3 if name not in ("tsdf", "depth") else [255, 128, 0])).max() <= 2


def test_poisson_through_the_centres_is_a_closed_outward_ball(ball):
    mesh, report = extract_mesh(ball.gaussians, *ball.views, method=centers_poisson())
    assert signed_volume(mesh) == pytest.approx(4 / 3 * np.pi, rel=0.05)
    assert report["topology"]["components"] == 1
    assert report["seen"]["points"] == 2000


def test_a_centre_that_no_view_sees_has_no_outside(ball):
    towards = methods.directions_to_viewers(
        np.array([[0.0, 0, 1], [0, 0, 0], [0, 0, 3]]), np.full(3, 0.1), ball.cameras, ball.pictures
    )
    assert towards[0, 2] > 0
    np.testing.assert_array_equal(towards[1:], 0)
    blank = [p._replace(depth=np.zeros_like(p.depth)) for p in ball.pictures]
    with pytest.raises(InputError, match="no view sees the centre of any of 2000 Gaussians"):
        extract_mesh(ball.gaussians, ball.cameras, blank, method=centers_poisson())


def test_plane_normals_of_a_plane():
    rng = np.random.default_rng(0)
    axis = np.array([1.0, 2.0, -2.0]) / 3
    points = rng.normal(size=(300, 3))
    points -= (points @ axis)[:, None] * axis
    np.testing.assert_allclose(np.abs(methods.plane_normals(points, 16) @ axis), 1, atol=1e-9)


def test_fusion_leaves_open_what_nothing_saw(ball):
    views = ball.cameras[:1], ball.pictures[:1]
    mesh, report = extract_mesh(ball.gaussians, *views, method=tsdf(voxel=0.06))
    eye = -ball.cameras[0].viewmat[:3, :3].T @ ball.cameras[0].viewmat[:3, 3]
    assert (mesh.vertices @ (eye / np.linalg.norm(eye))).min() > -0.2
    assert not report["topology"]["watertight"]


def test_fused_surfaces_lie_at_the_depth_and_not_half_a_voxel_beside(ball_on_ground):
    mesh, _ = extract_mesh(
        ball_on_ground.gaussians,
        *ball_on_ground.views,
        method=tsdf(voxel=0.1),
        regions=lambda _: boxes.fixed_boxes(Box((1.5, -2, -2), (2.4, 2, 0))),
    )
    assert abs(np.median(mesh.vertices[:, 2]) + 1) < 0.01


def test_points_of_the_depth_are_where_it_has_a_normal_that_faces_the_camera(ball):
    """A plane before a turned camera: no normal on its left half, and seen too flatly in the lower one."""
    camera = ball.cameras[3]
    size = camera.height, camera.width
    colors = np.full((*size, 3), 0.5, np.float32)
    plane = Picture(colors, np.full(size, 2.5, np.float32), np.ones(size, np.float32))
    flat = np.array([0, np.sqrt(1 - 0.1**2), -0.1])

    def normals_of(depth, alphas, camera):
        normals = np.zeros((*size, 3))
        normals[:, size[1] // 2 :] = [0, 0, -1]
        normals[size[0] // 2 :, size[1] // 2 :] = flat
        return normals

    points = depth_poisson(normals_of, 10**6)(ball.gaussians, [camera], [plane]).points
    local = points @ np.asarray(camera.viewmat)[:3, :3].T + np.asarray(camera.viewmat)[:3, 3]
    pixels = local[:, :2] / local[:, 2:] * np.asarray(camera.K)[[0, 1], [0, 1]] + np.asarray(camera.K)[:2, 2]
    np.testing.assert_allclose(local[:, 2], 2.5, rtol=1e-5)
    rows, columns = np.mgrid[: size[0], : size[1]]
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones(size)], -1) @ np.linalg.inv(np.asarray(camera.K, np.float64)).T
    facing = -np.sum(rays * normals_of(None, None, None), axis=-1) / np.linalg.norm(rays, axis=-1)
    found = np.zeros(size, bool)
    found[np.floor(pixels[:, 1]).astype(int), np.floor(pixels[:, 0]).astype(int)] = True
    np.testing.assert_array_equal(found, facing > LEAST_FACING)
    assert 0.2 < found.mean() < 0.3


def test_a_depth_without_normals_has_no_surface(ball):
    with pytest.raises(InputError, match="no pixel of 10 views has alpha > 0.5 and a normal"):
        extract_mesh(ball.gaussians, *ball.views, method=depth_poisson(lambda d, a, c: np.zeros((*d.shape, 3)), 1000))
    with pytest.raises(InputError, match="no mesh: there is no camera to look from"):
        extract_mesh(ball.gaussians, [], [], method=depth_poisson(smoothed_depth_normals, 1000))


def test_nothing_opaque_cannot_be_fused(ball):
    blank = [p._replace(alphas=np.zeros_like(p.alphas)) for p in ball.pictures]
    with pytest.raises(InputError, match="no pixel of 10 views"):
        extract_mesh(ball.gaussians, ball.cameras, blank, method=tsdf())


def test_the_grid_holds_the_density_at_its_own_points():
    scene = gs.Gaussians(
        means=np.float32([[0.3, -0.2, 0.1], [5, 5, 5]]),
        quats=np.float32([[1, 0, 0, 0], [1, 0, 0, 0]]),
        log_scales=np.log(np.float32([[0.4, 0.3, 0.2], [0.1, 0.1, 0.1]])),
        logit_opacities=np.float32([1.0, 9.0]),
        sh_dc=np.zeros((2, 1, 3), np.float32),
        sh_rest=np.zeros((2, 0, 3), np.float32),
    )
    box, step = Box((-1, -0.9, -0.8), (1, 0.9, 0.8)), 0.1
    grid = density_grid(scene, box, step)
    z, y, x = np.meshgrid(*[np.arange(n) for n in grid.shape], indexing="ij")
    offset = (box.low + step * np.stack([x, y, z], -1) - [0.3, -0.2, 0.1]) / [0.4, 0.3, 0.2]
    distance = np.linalg.norm(offset, axis=-1)
    expected = np.exp(-0.5 * distance**2) / (1 + np.exp(-1.0))
    inside = distance < 3  # Beyond, whole blocks may be left out.
    np.testing.assert_allclose(grid[inside], expected[inside], atol=2e-6)
    assert grid[~inside].max() <= expected[~inside].max() + 2e-6


def test_a_grid_that_no_machine_holds_is_refused():
    box = Box((-1, -1, -1), (1, 1, 1))
    with pytest.raises(InputError, match=r"^a grid of cells of 1e-06 scene units takes 8.\d+e\+10 GiB of memory; "):
        density_grid(cloud(3), box, 1e-6)
    camera = camera_at((0.0, 0.0, 0.0), (0.0, 0.0, 4.0), size=(16, 16))
    depth = np.full((16, 16), 3.0, np.float32)
    picture = Picture(colors=np.zeros((16, 16, 3)), alphas=np.ones((16, 16)), depth=depth, owners=None)
    sighting = tsdf(voxel=1e-6)(cloud(3), [camera], [picture])
    with pytest.raises(InputError, match=r"^a grid of voxels of 1e-06 scene units takes .*e\+\d+ GiB of memory; "):
        sighting.build(Region(Box((-9, -9, -9), (9, 9, 9))))


def test_vertices_of_a_round_gaussian_lie_on_its_level_sphere():
    scene = gs.Gaussians(
        means=np.float32([[0.111, -0.07, 0.03]]),
        quats=np.float32([[1, 0, 0, 0]]),
        log_scales=np.log(np.full((1, 3), 0.5, np.float32)),
        logit_opacities=np.float32([2.0]),
        sh_dc=np.zeros((1, 1, 3), np.float32),
        sh_rest=np.zeros((1, 0, 3), np.float32),
    )
    sighting = marching_cubes(level=0.3, cell=0.05)(scene, [], [])
    mesh, _ = sighting.build(Region(Box((-2, -2, -2), (2, 2, 2))))
    radius = 0.5 * np.sqrt(2 * np.log(1 / (1 + np.exp(-2.0)) / 0.3))
    # Half a cell would be 0.025.
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices - [0.111, -0.07, 0.03], axis=1), radius, atol=1e-3)
    assert signed_volume(mesh) == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.01)
    with pytest.raises(InputError, match=r"density stays under 0.95"):
        marching_cubes(level=0.95, cell=0.05)(scene, [], []).build(Region(Box((-2, -2, -2), (2, 2, 2))))


def test_faces_that_look_away_from_the_views_are_turned_about(ball):
    mesh, _ = extract_mesh(ball.gaussians, *ball.views, method=centers_poisson())
    inside_out = Mesh(mesh.vertices, mesh.faces[:, ::-1].copy(), mesh.colors)
    assert facing_share(mesh, ball.cameras) == 1
    assert facing_share(inside_out, ball.cameras) == 0
    turned, share = orient_outward(inside_out, ball.cameras)
    assert share == 1
    np.testing.assert_allclose(face_normals(turned), face_normals(mesh), atol=1e-12)
    nowhere = Mesh(mesh.vertices + np.float32(100), mesh.faces, mesh.colors)
    assert facing_share(nowhere, ball.cameras) == 1


@pytest.mark.parametrize("method", ALL.values(), ids=ALL)
def test_a_box_with_nothing_in_it_is_one_line_for_all(ball, method):
    nowhere = Box((5, 5, 5), (6, 6, 6))
    with pytest.raises(InputError, match=r"the box .* holds none of"):
        extract_mesh(ball.gaussians, *ball.views, method=method, regions=partial(lambda _: boxes.fixed_boxes(nowhere)))
