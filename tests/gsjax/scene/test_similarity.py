"""Worlds far off, small and turned: what is read is as at the origin, what is written is where the user has it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scenes import cloud

from gsjax import runs
from gsjax.errors import InputError
from gsjax.io import gaussian_files, json_files
from gsjax.io.images import write_image
from gsjax.io.ply import write_gaussians
from gsjax.io.ply_elements import read_elements
from gsjax.io.scenes import load_scene
from gsjax.meshing import export
from gsjax.meshing.atlas import Atlas, TexturedMesh
from gsjax.runs.result import open_result
from gsjax.scene import similarity as similarities
from gsjax.scene.georeference import UNPLACED
from gsjax.scene.meshes import Mesh
from gsjax.scene.similarity import Similarity

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
WORLDS = {
    "as it is": (1.0, np.eye(3), np.zeros(3)),
    "utm": (1.0, np.eye(3), np.array([512_345.6, 4_500_123.4, 103.2])),
    "a thousandth": (1e-3, np.eye(3), np.zeros(3)),
    "a millionth, far off": (1e-6, np.eye(3), np.array([0.2, -0.7, 0.1])),
    "turned and shifted": (2.7, TURN, np.array([-3e5, 20.0, 7e4])),
}
K = np.array([[50.0, 0, 20], [0, 50, 15], [0, 0, 1]])
FLIP = np.diag([1.0, -1, -1, 1])  # OpenGL's camera axes


def ring(count=8):
    """`[V, 4, 4]` float64 camera to world, OpenCV axes, of cameras around the origin that look at it."""
    angles = 2 * np.pi * np.arange(count) / count
    eyes = np.stack([3 * np.cos(angles), 2.5 * np.sin(angles), 0.4 * np.cos(3 * angles)], -1)
    z = -eyes / np.linalg.norm(eyes, axis=1, keepdims=True)
    x = np.cross([0.0, 0, 1], z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.concatenate([np.stack([x, np.cross(z, x), z, eyes], -1), np.tile([[[0.0, 0, 0, 1]]], (count, 1, 1))], 1)


POSES = ring()
POINTS = np.random.default_rng(0).normal(size=(50, 3))


def moved(world, points):
    scale, turn, shift = WORLDS[world]
    return scale * points @ turn.T + shift


def write_scene(folder, world):
    """The scene in a world, as `transforms.json` with a PLY of double points and one depth map."""
    scale, turn, _ = WORLDS[world]
    frames = []
    for index, pose in enumerate(POSES):
        there = np.eye(4)
        there[:3, :3], there[:3, 3] = turn @ pose[:3, :3], moved(world, pose[:3, 3])
        frames.append({"file_path": f"images/{index}.png", "transform_matrix": (there @ FLIP).tolist()})
        write_image(folder / f"images/{index}.png", np.full((30, 40, 3), 20 * index, np.uint8))
    meta = {"w": 40, "h": 30, "fl_x": 50, "fl_y": 50, "cx": 20, "cy": 15, "ply_file_path": "points.ply"}
    (folder / "transforms.json").write_text(json.dumps({**meta, "frames": frames}))
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 50\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
    (folder / "points.ply").write_bytes(header.encode() + moved(world, POINTS).astype("<f8").tobytes())
    (folder / "depth").mkdir()
    np.savez(folder / "depth/0.npz", depth=np.full((30, 40), 3.0 * scale), label=np.ones((30, 40), np.uint8))
    return folder


def project(viewmats, points):
    """`[V, P, 2]` pixels, float64, of points before cameras; and the depths `[V, P]`."""
    local = np.einsum("vij,pj->vpi", viewmats[:, :3, :3], points) + viewmats[:, None, :3, 3]
    pixels = local @ K.T
    return pixels[..., :2] / pixels[..., 2:], local[..., 2]


@pytest.mark.parametrize("world", WORLDS)
def test_what_is_read_looks_the_same_in_every_world(world, tmp_path):
    scene = load_scene(write_scene(tmp_path, world))
    viewmats = np.stack([frame.viewmat for frame in scene.frames])
    assert viewmats.dtype == scene.points.dtype == np.float32
    pixels, depths = project(viewmats.astype(np.float64), scene.points.astype(np.float64))
    expected, expected_depths = project(np.linalg.inv(POSES), POINTS)
    # Float32 coordinates within some tens of units: a few ten-thousandths of a pixel.
    np.testing.assert_allclose(pixels, expected, atol=2e-3)
    units = scene.similarity.scale * WORLDS[world][0]
    np.testing.assert_allclose(depths, units * expected_depths, atol=2e-5)
    np.testing.assert_allclose(scene.truth.depths["0.png"](), np.full((30, 40), 3.0 * units), rtol=1e-6)
    centers = -np.einsum("vji,vj->vi", viewmats[:, :3, :3], viewmats[:, :3, 3])
    assert np.abs(np.median(centers, axis=0)).max() <= 16.001
    assert 1 <= similarities.spread(centers) < 4.001


def gaussians_in(world):
    """Gaussians at the origin, and the same in a world that is not turned, with float64 means."""
    here = cloud(40)
    log_scales = np.asarray(here.log_scales) + np.log(WORLDS[world][0])
    return here, replace(here, means=moved(world, np.asarray(here.means, np.float64)), log_scales=log_scales)


@pytest.mark.parametrize("world", ["utm", "a thousandth"])
def test_gaussians_come_back_to_the_same_local_ones(world, tmp_path):
    here, there = gaussians_in(world)
    similarity = similarities.of_points(np.asarray(there.means))
    write_gaussians(tmp_path / "g.ply", similarity.gaussians_to_world(similarity.gaussians_to_local(there)))
    vertices = read_elements(tmp_path / "g.ply")[0]["vertex"]
    assert {vertices.dtype[axis].str for axis in "xyz"} == {"<f8" if world == "utm" else "<f4"}, "where float loses it"
    assert {vertices.dtype[name].str for name in vertices.dtype.names if name not in "xyz"} == {"<f4"}
    result = open_result(tmp_path / "g.ply")
    assert result.similarity == similarity
    assert result.gaussians.means.dtype == result.gaussians.log_scales.dtype == np.float32
    units = similarity.scale * WORLDS[world][0]
    offset = np.median(result.gaussians.means - units * np.asarray(here.means), axis=0)
    np.testing.assert_allclose(result.gaussians.means - offset, units * np.asarray(here.means), atol=2e-5)
    np.testing.assert_allclose(result.gaussians.log_scales, np.asarray(here.log_scales) + np.log(units), atol=1e-5)


def apart(result, original):
    """The largest distance of means, in whatever order they were stored."""
    distances = np.linalg.norm(result.means[:, None] - original.means, axis=-1)
    nearest = distances.argmin(axis=0)
    np.testing.assert_allclose(result.log_scales[nearest], original.log_scales, atol=0.04)
    return distances.min(axis=0).max()


@pytest.mark.parametrize("suffix", [".spz", ".sog", ".compressed.ply"])
def test_compressed_files_are_local_where_they_have_to_be_and_say_so(suffix, tmp_path):
    file = tmp_path / f"g{suffix}"
    form = gaussian_files.format_of(file)
    usual = gaussians_in("as it is")[1]
    form.write(file, usual, UNPLACED)
    alone = apart(form.read(file), usual)
    assert [path.name for path in tmp_path.iterdir()] == [file.name]
    for world in ("utm", "a thousandth"):
        there = gaussians_in(world)[1]
        assert form.write(file, there, UNPLACED) == 0, "nothing is clipped"
        assert json.loads((tmp_path / f"{file.name}.similarity.json").read_text())["scale"] in (1, 1024)
        assert apart(form.read(file), there) / WORLDS[world][0] < 2 * alone + 1e-5
    form.write(file, usual, UNPLACED)
    assert [path.name for path in tmp_path.iterdir()] == [file.name], "what told the other place is gone"


@pytest.mark.parametrize("world", ["utm", "a thousandth"])
@pytest.mark.parametrize("name", ["m.ply", "m.obj", "m.glb", "textured.obj", "textured.glb"])
def test_meshes_keep_their_place(world, name, tmp_path):
    faces = np.arange(48, dtype=np.int32).reshape(16, 3)
    mesh = Mesh(moved(world, POINTS[:48]), faces, np.full((48, 3), 90, np.uint8))
    if name.startswith("textured"):
        uvs = np.random.default_rng(1).uniform(0.1, 0.9, (48, 2)).astype(np.float32)
        atlas = Atlas(uvs, np.arange(48, dtype=np.int32), faces, 8, 0)
        export.write_textured(tmp_path / name, TexturedMesh(mesh, atlas, np.full((8, 8, 3), 90, np.uint8)))
    else:
        export.write_mesh(tmp_path / name, mesh)
    result = export.read_mesh(tmp_path / name)
    assert result.vertices.dtype == (np.float32 if world == "a thousandth" else np.float64)
    (tmp_path / "browser.glb").write_bytes(export.glb_bytes(tmp_path / name))
    for read in (result, export.read_mesh(tmp_path / "browser.glb")):
        np.testing.assert_allclose(read.vertices[read.faces], mesh.vertices[faces], atol=1e-6 * WORLDS[world][0])


@pytest.mark.parametrize(
    "record", [{"scale": 0, "center": [0, 0, 0]}, {"scale": 4.0, "center": [1e300, 0, 0]}, {"scale": 1}]
)
def test_a_similarity_that_no_scene_has_is_refused(record, tmp_path):
    json_files.write(tmp_path / "manifest.json", {"similarity": record})
    with pytest.raises(InputError, match=r"manifest\.json.*similarity"):
        runs.read_similarity(tmp_path)


def test_lengths_and_poses_go_there_and_back():
    similarity = Similarity(4.0, (500_000.0, -64.0, 32.0))
    viewmat = np.linalg.inv(POSES[3])
    world = similarity.viewmat_to_world(viewmat)
    np.testing.assert_allclose(world[:3, :3] @ similarity.points_to_world(POINTS[0]) + world[:3, 3],
                               (viewmat[:3, :3] @ POINTS[0] + viewmat[:3, 3]) / 4, atol=1e-9)  # fmt: skip
    np.testing.assert_allclose(similarity.viewmat_to_local(world), viewmat, atol=1e-9)
    report = {"cell": 2.0, "box": [1.0], "inner": {"cell": 8.0, "none": {"cell": None}}}
    in_world = {"cell": 0.5, "box": [1.0], "inner": {"cell": 2.0, "none": {"cell": None}}}
    assert similarity.figures_to_world(report, {"cell"}) == in_world
