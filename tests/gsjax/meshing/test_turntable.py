import numpy as np
import pytest
import trimesh
from PIL import Image

from gsjax import cli
from gsjax.errors import InputError
from gsjax.meshes import Mesh
from gsjax.meshing.atlas import Atlas, TexturedMesh
from gsjax.meshing.export import write_mesh, write_textured
from gsjax.meshing.pictures import render_mesh, texture_colors
from gsjax.meshing.rays import front_faces_only, ray_caster
from gsjax.meshing.turntable import turntable, write_turntable


@pytest.fixture
def box() -> Mesh:
    """A long box off the origin: red at its upper end in z, green at +x, blue elsewhere."""
    solid = trimesh.creation.box((2.0, 1.0, 3.0)).subdivide().subdivide()
    x, _, z = solid.vertices.T
    colors = np.where((z > 0.7)[:, None], [255, 0, 0], np.where((x > 0.9)[:, None], [0, 255, 0], [0, 0, 255]))
    vertices = (solid.vertices + [5, -3, 40]).astype(np.float32)
    return Mesh(vertices, solid.faces.astype(np.int32), colors.astype(np.uint8))


def rows_of(picture):
    """Mean row of the red pixels, and of all others that are not white, in heights of the picture from the top."""
    is_red = (picture[..., 0] > 200) & (picture[..., 1:].max(-1) < 60)
    is_other = np.any(picture < 250, axis=-1) & ~is_red
    return np.nonzero(is_red)[0].mean() / len(picture), np.nonzero(is_other)[0].mean() / len(picture)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -2.0), (0, -1, 0), (0.3, 0.5, 1.0)])
def test_what_is_up_is_up_in_every_frame(box, up):
    # The box turned so that its red end points up.
    to_up = trimesh.geometry.align_vectors([0, 0, 1], np.asarray(up, float))[:3, :3]
    turned = Mesh((box.vertices @ to_up.T).astype(np.float32), box.faces, box.colors)
    for picture in turntable(turned, frames=4, size=64, up=np.array(up)):
        red, others = rows_of(picture)
        assert red < others - 0.1
        border = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
        assert np.all(border == 255), "cut off"
        assert np.mean(np.any(picture != 255, axis=-1)) > 0.1


def test_a_turn_shows_every_side_once(box):
    frames = list(turntable(box, frames=4, size=48))
    assert all(frame.shape == (48, 48, 3) and frame.dtype == np.uint8 for frame in frames)
    green = [np.sum((frame[..., 1] > 200) & (frame[..., 2] < 60) & (frame[..., 0] < 60)) for frame in frames]
    assert np.max(green) > 20
    assert np.min(green) == 0
    for first in range(4):
        for second in range(first):
            assert np.mean(frames[first] != frames[second]) > 0.02


def test_a_room_is_looked_into_through_its_walls(box):
    room = Mesh(box.vertices, box.faces[:, ::-1].copy(), box.colors)
    for inside, outside in zip(turntable(room, frames=3, size=48), turntable(box, frames=3, size=48), strict=True):
        assert not np.any(np.all(inside == [115, 0, 0], axis=-1)), "a back face is seen"
        covered = [np.any(picture != 255, axis=-1).mean() for picture in (inside, outside)]
        assert covered[0] == pytest.approx(covered[1], rel=0.05)  # the outline of a convex body
        assert np.mean(inside != outside) > 0.02


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
    vertices = np.array([[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]], np.float32)
    mesh = Mesh(vertices, np.array([[0, 2, 1], [0, 3, 2]], np.int32), np.zeros((4, 3), np.uint8))
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)  # y down, as the camera's
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 256, (8, 8, 3), dtype=np.uint8)
    textured = TexturedMesh(mesh, Atlas(uvs, np.arange(4, dtype=np.int32), mesh.faces, 8, 1), texture)
    K = np.array([[8.0, 0, 4], [0, 8.0, 4], [0, 0, 1]])  # a pixel a texel
    picture = render_mesh(mesh, np.eye(4), K, 8, 8, shading=texture_colors(textured))
    assert np.abs(picture.astype(int) - texture).max() <= 1
    # Half a pixel to the right: halfway between two texels.
    K[0, 2] = 3.5
    picture = render_mesh(mesh, np.eye(4), K, 8, 8, shading=texture_colors(textured))
    halfway = (texture[:, :-1].astype(float) + texture[:, 1:]) / 2
    assert np.abs(picture[:, :-1] - halfway).max() <= 1


@pytest.mark.parametrize("count", [1, 5])
def test_files_hold_every_frame(tmp_path, count):
    pictures = [np.full((10, 10, 3), 40 * k, np.uint8) for k in range(count)]
    write_turntable(tmp_path / "t.png", pictures)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "t.png")), np.concatenate(pictures, axis=1))
    write_turntable(tmp_path / "t.gif", pictures)
    with Image.open(tmp_path / "t.gif") as animation:
        assert getattr(animation, "n_frames", 1) == count
        for index in range(count):
            animation.seek(index)
            assert np.abs(np.asarray(animation.convert("RGB")).astype(int) - 40 * index).max() <= 2
    assert sorted(p.name for p in tmp_path.iterdir()) == ["t.gif", "t.png"]


def test_the_command_draws_textures_and_vertex_colours(tmp_path, box):
    write_mesh(tmp_path / "m.ply", box)
    white = Atlas(np.zeros_like(box.vertices[:, :2]), np.arange(box.num_vertices, dtype=np.int32), box.faces, 4, 1)
    write_textured(tmp_path / "m.glb", TexturedMesh(box, white, np.full((4, 4, 3), [0, 200, 200], np.uint8)))
    for name, out in (("m.ply", "v.png"), ("m.glb", "t.png")):
        command = ["turntable", str(tmp_path / name), "--out", str(tmp_path / out), "--frames", "3", "--size", "32"]
        assert cli.main(command) == 0
    colored, plain = (np.asarray(Image.open(tmp_path / name)) for name in ("v.png", "t.png"))
    assert colored.shape == plain.shape == (32, 96, 3)
    assert np.less(*rows_of(colored))
    covered = np.any(plain != 255, axis=-1)
    np.testing.assert_array_equal(covered, np.any(colored != 255, axis=-1))
    assert np.all(np.abs(np.median(plain[covered], axis=0) - [0, 200, 200]) <= 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "t.mp4"], "t.mp4: turntables end in .gif or .png"),
        (["--out", "t.gif", "--frames", "0"], "--frames 0 is not between 1 and 3600"),
        (["--out", "t.gif", "--size", "-3"], "--size -3 is not between 1 and 4096"),
        (["--out", "t.gif", "--size", "10000"], "--size 10000 is not between 1 and 4096"),
        (["--out", "t.gif", "--up", "0", "0", "0"], "--up 0 0 0 is no direction"),
        (["--out", "t.gif"], "absent.ply: no such mesh file"),
    ],
)
def test_bad_input_is_one_line_and_code_2(tmp_path, monkeypatch, capsys, options, message):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["turntable", "absent.ply", *options]) == 2
    assert capsys.readouterr().err == f"gsjax: error: {message}\n"
    assert not list(tmp_path.iterdir())


def test_an_unknown_suffix_is_refused_before_anything_is_drawn(tmp_path):
    with pytest.raises(InputError, match=r"\.gif or \.png"):
        write_turntable(tmp_path / "t.jpg", [])


def test_the_circle_is_twenty_degrees_above_the_middle():
    """A disc that faces up is as high in the picture as the sine of 20 degrees of its width; one that faces down is not
    seen."""
    angles = 2 * np.pi * np.arange(90) / 90
    rim = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
    vertices = np.concatenate([rim, [[0, 0, 0]]]).astype(np.float32)
    faces = np.stack([np.arange(90), np.roll(np.arange(90), -1), np.full(90, 90)], axis=-1).astype(np.int32)
    upward = Mesh(vertices, faces, np.zeros((91, 3), np.uint8))
    for picture in turntable(upward, frames=3, size=256):
        rows, columns = np.nonzero(np.any(picture < 128, axis=-1))
        assert np.ptp(rows) / np.ptp(columns) == pytest.approx(np.sin(np.radians(20.0)), rel=0.08)
    downward = Mesh(vertices, faces[:, ::-1].copy(), upward.colors)
    assert all(np.all(picture == 255) for picture in turntable(downward, frames=3, size=64))
