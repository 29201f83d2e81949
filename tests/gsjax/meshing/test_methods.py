"""Fusion of depth: the mesh of a ball of discs; and the table of all mesh methods."""

import meshes
import numpy as np
import pytest
from small_scenes import camera_at, cloud

from gsjax.errors import InputError
from gsjax.meshing import regions
from gsjax.meshing.extract import extract_mesh, facing_share, orient_outward
from gsjax.meshing.methods import METHODS, MeshMethod, MethodOptions, methods_help, methods_of
from gsjax.meshing.regions import Box, Region
from gsjax.meshing.tsdf import tsdf
from gsjax.normals.from_depth import depth_normals, smoothed_depth_normals
from gsjax.rendering.gallery import Picture

FUSION = tsdf(smoothed_depth_normals, voxel=0.06)


def test_fusion_leaves_open_what_nothing_saw(ball):
    views = ball.cameras[:1], ball.pictures[:1]
    mesh, report = extract_mesh(ball.gaussians, *views, method=FUSION)
    eye = -ball.cameras[0].viewmat[:3, :3].T @ ball.cameras[0].viewmat[:3, 3]
    assert (mesh.vertices @ (eye / np.linalg.norm(eye))).min() > -0.2
    assert not report["topology"]["watertight"]


def test_fused_surfaces_lie_at_the_depth_and_not_half_a_voxel_beside(ball_on_ground):
    mesh, _ = extract_mesh(
        ball_on_ground.gaussians,
        *ball_on_ground.views,
        method=tsdf(smoothed_depth_normals, voxel=0.1),
        regions=lambda _: regions.fixed_boxes(Box((1.5, -2, -2), (2.4, 2, 0))),
    )
    assert abs(np.median(mesh.vertices[:, 2]) + 1) < 0.01


def test_a_depth_without_normals_has_no_surface(ball):
    with pytest.raises(InputError, match="no pixel of 10 views has alpha > 0.5 and a normal"):
        extract_mesh(ball.gaussians, *ball.views, method=tsdf(lambda d, a, c: np.zeros((*d.shape, 3))))


def test_a_view_of_a_pixel_or_two_is_left_out(ball):
    """Open3D looks for the blocks of a view at every fourth pixel."""
    first = ball.pictures[0]
    few = np.zeros_like(first.depth)
    few[29:31, 29:31] = first.depth[29:31, 29:31]
    views = [first._replace(depth=few), *ball.pictures[1:]]
    normals = lambda depth, _, camera: depth_normals(depth, camera)  # noqa: E731
    mesh, _ = extract_mesh(ball.gaussians, ball.cameras, views, method=tsdf(normals, voxel=0.06))
    assert mesh.num_faces > 1000
    assert np.abs(mesh.colors.astype(int) - [255, 128, 0]).max() <= 2


def test_a_grid_that_no_machine_holds_is_refused():
    camera = camera_at((0.0, 0.0, 0.0), (0.0, 0.0, 4.0), size=(16, 16))
    depth = np.full((16, 16), 3.0, np.float32)
    picture = Picture(colors=np.zeros((16, 16, 3)), alphas=np.ones((16, 16)), depth=depth, owners=None)
    towards = np.tile([0.0, 0.0, -1.0], (16, 16, 1))
    sighting = tsdf(lambda *_: towards, voxel=1e-6)(cloud(3), [camera], [picture])
    with pytest.raises(InputError, match=r"^a grid of voxels of 1e-06 scene units takes .*e\+\d+ GiB of memory; "):
        sighting.build(Region(Box((-9, -9, -9), (9, 9, 9))))


def test_faces_that_look_away_from_the_views_are_turned_about(ball):
    mesh = meshes.ball(3)
    assert facing_share(mesh, ball.cameras) == 1
    assert facing_share(meshes.turned(mesh), ball.cameras) == 0
    outward, share = orient_outward(meshes.turned(mesh), ball.cameras)
    assert share == 1
    np.testing.assert_array_equal(outward.faces, mesh.faces)
    assert facing_share(meshes.ball(3, center=(100, 100, 100)), ball.cameras) == 1, "no ray meets it"


def test_one_entry_registers_a_method_for_its_name_the_help_and_auto(monkeypatch):
    assert list(methods_of("auto", MethodOptions(level=0.2, points=900))) == ["poisson"]
    assert list(methods_of("auto", MethodOptions(cell=0.1))) == ["tsdf"], "the methods that read the options"
    own = MeshMethod("planes by hand", lambda *_: FUSION, options=frozenset({"trim_quantile"}))
    monkeypatch.setitem(METHODS, "planes", own)
    assert methods_of("planes", MethodOptions(trim_quantile=0.1)) == {"planes": own}
    assert list(methods_of("auto", MethodOptions())) == ["poisson", "tsdf", "planes"]
    assert "  planes: planes by hand\n      --trim-quantile" in methods_help()
    with pytest.raises(InputError, match="^method=nurbs is none of auto, poisson, tsdf, planes$"):
        methods_of("nurbs", MethodOptions())


@pytest.mark.parametrize(
    ("method", "options", "fault"),
    [
        ("auto", {"cell": 0.1, "level": 0.2}, "no method reads cell and level together"),
        ("poisson", {"cell": 0.1}, "cell is an option of the method tsdf; poisson does not read it"),
    ],
)
def test_an_option_that_the_method_does_not_read_is_refused(method, options, fault):
    with pytest.raises(InputError) as caught:
        methods_of(method, MethodOptions(**options))
    assert str(caught.value) == fault
