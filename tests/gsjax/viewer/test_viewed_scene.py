"""What can be looked at, and the one line for what cannot."""

import numpy as np
import pytest
from meshes import tetrahedron
from run_folders import write_run
from small_scenes import camera_at, cloud

from gsjax.errors import InputError
from gsjax.gaussians import take
from gsjax.io.ply import write_gaussians
from gsjax.meshing.export import glb_bytes, read_mesh, write_mesh
from gsjax.viewer.viewed_scene import open_viewed_scene

CAMERAS = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0), size=(24, 20)) for x in (-0.5, 0.5)]
TETRAHEDRON = tetrahedron()


@pytest.fixture
def run(tmp_path):
    return write_run(tmp_path / "run", cloud(30), CAMERAS)


def test_a_run_brings_its_cameras_and_its_mesh_and_says_why_there_are_no_photos(run):
    messages = []
    viewed = open_viewed_scene(run, notify=messages.append)
    assert messages == [f"no photos: {run}/manifest.json: cannot be read (No such file or directory)"]
    assert list(viewed.cameras) == ["0.jpg", "1.jpg"] and not viewed.photos and viewed.mesh is None
    np.testing.assert_array_equal(viewed.background, [1, 1, 1])
    np.testing.assert_array_equal(viewed.start.viewmat, CAMERAS[0].viewmat)
    np.testing.assert_allclose(viewed.up, [0, -1, 0], atol=1e-6)
    assert 3 < viewed.scale < 5 and np.linalg.norm(viewed.middle - [0, 0, 4]) < 1
    write_mesh(run / "mesh.ply", TETRAHEDRON)
    assert open_viewed_scene(run).mesh == run / "mesh.ply"
    write_mesh(run / "other.obj", TETRAHEDRON)
    assert open_viewed_scene(run, mesh=run / "other.obj").mesh == run / "other.obj"


def test_a_mesh_alone_is_shown_as_a_mesh_from_where_it_is_seen_whole(tmp_path):
    file = tmp_path / "m.obj"
    write_mesh(file, TETRAHEDRON)
    viewed = open_viewed_scene(file)
    assert viewed.gaussians is None and viewed.mesh == file
    camera_points = TETRAHEDRON.vertices @ viewed.start.viewmat[:3, :3].T + viewed.start.viewmat[:3, 3]
    pixels = camera_points @ np.asarray(viewed.start.K).T
    pixels = pixels[:, :2] / pixels[:, 2:]
    assert (camera_points[:, 2] > 0).all() and (pixels > 0).all() and (pixels < [800, 600]).all()
    np.testing.assert_array_equal(viewed.up, [0, 0, 1])
    # What the browser gets holds the same triangles and colours.
    (tmp_path / "back.glb").write_bytes(glb_bytes(file))
    back = read_mesh(tmp_path / "back.glb")
    np.testing.assert_array_equal(back.vertices[back.faces], TETRAHEDRON.vertices[TETRAHEDRON.faces])
    np.testing.assert_array_equal(back.colors[back.faces], TETRAHEDRON.colors[TETRAHEDRON.faces])


def test_what_cannot_be_shown_is_one_line(tmp_path, run):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "points.ply").write_text("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n")
    write_mesh(tmp_path / "m.ply", TETRAHEDRON)
    write_gaussians(run / "gaussians.ply", take(cloud(1), slice(0)))
    for name, message in {
        "absent": "no such file or folder",
        "empty": "holds no gaussians.ply; it is no run folder",
        "run": "holds no Gaussians, there is nothing to show",
        "notes.txt": "is no run folder, and no file of Gaussians (.compressed.ply, .ply, .sog, .spz) "
        "or of a mesh (.ply, .obj, .glb)",
        "points.ply": "not a PLY of Gaussians, it lacks",
    }.items():
        with pytest.raises(InputError) as raised:
            open_viewed_scene(tmp_path / name)
        assert str(raised.value).startswith(f"{tmp_path / name}: {message}") and "\n" not in str(raised.value)
    with pytest.raises(InputError, match="m.ply: is a mesh itself; a second mesh goes with Gaussians"):
        open_viewed_scene(tmp_path / "m.ply", mesh=tmp_path / "m.ply")
    with pytest.raises(InputError, match="absent.glb: no such mesh file"):
        open_viewed_scene(run, mesh=tmp_path / "absent.glb")
