"""Pictures and films of runs and meshes: how many, of what, and from where; bad options are one line."""

import json

import cv2
import numpy as np
import pytest
import trimesh
from PIL import Image
from run_folders import write_run
from small_scenes import camera_at, cloud

from gsjax import cli, pipeline
from gsjax.io import json_files
from gsjax.io.images import read_image
from gsjax.meshing.atlas import Atlas, TexturedMesh
from gsjax.meshing.export import write_mesh, write_textured
from gsjax.pipeline.render import picture_stems
from gsjax.rendering import gallery
from gsjax.runs import viewpoints
from gsjax.scene.cameras import viewmat_center
from gsjax.scene.meshes import Mesh

POSES = [{"viewmat": (np.eye(4) + shift * np.eye(4, k=3)).tolist(), "fov": 50.0} for shift in (0, 1, 3)]


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A run of ten cameras along x. Its pictures are grey by the camera's x, so nothing is compiled."""
    cameras = [camera_at((x, 0.0, 0.0), (x, 0.0, 4.0), size=(24, 20)) for x in np.linspace(-1, 1, 10)]
    folder, drawn_cameras = write_run(tmp_path / "run", cloud(30), cameras), []

    def draw(gaussians, cameras, background, depth_mode="plane"):
        for camera in cameras:
            drawn_cameras.append(camera)
            grey = np.full((camera.height, camera.width), (viewmat_center(camera.viewmat)[0] + 1) / 2, np.float32)
            yield gallery.Picture(np.repeat(grey[..., None], 3, -1), 1 + grey, np.ones_like(grey))

    monkeypatch.setattr(gallery, "pictures", draw)
    return folder, drawn_cameras


def gif_pictures(path):
    """`[T, H, W, 3]`, and how many milliseconds each is shown; equal pictures in a row are there once."""
    pictures, durations = [], []
    with Image.open(path) as animation:
        for index in range(animation.n_frames):
            animation.seek(index)
            pictures.append(np.asarray(animation.convert("RGB")).astype(int))
            durations.append(animation.info["duration"])
    return np.array(pictures), durations


@pytest.fixture
def box() -> Mesh:
    """A long box far off the origin: red at its upper end in z, blue elsewhere."""
    solid = trimesh.creation.box((2.0, 1.0, 3.0)).subdivide().subdivide()
    colors = np.where((solid.vertices[:, 2] > 0.7)[:, None], [255, 0, 0], [0, 0, 255])
    return Mesh(
        (solid.vertices + [5, -3, 40]).astype(np.float32), solid.faces.astype(np.int32), colors.astype(np.uint8)
    )


def pictures_of(path):
    film = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    pictures = []
    while (picture := film.read()[1]) is not None:
        pictures.append(picture[..., ::-1])
    return np.array(pictures)


def test_a_film_past_the_photos_begins_at_the_first_and_ends_at_the_last(run, tmp_path, capsys):
    folder, cameras = run
    out = tmp_path / "film.mp4"
    arguments = ["--through-photos", "--seconds", "1.5", "--fps", "10", "--size", "64x48"]
    assert cli.main(["render", str(folder), "--out", str(out), *arguments]) == 0
    assert capsys.readouterr().out == f"rendered: {out}\n"
    np.testing.assert_allclose([viewmat_center(c.viewmat)[0] for c in cameras], np.linspace(-1, 1, 15), atol=1e-4)
    pictures = pictures_of(out)
    assert pictures.shape == (15, 48, 64, 3)
    np.testing.assert_allclose(pictures.mean(axis=(1, 2, 3)), np.linspace(0, 255, 15), atol=8)


def test_keyframes_are_in_the_coordinates_of_the_run(run, tmp_path):
    folder, cameras = run
    json_files.write(folder / "manifest.json", {"scene": "nowhere", "similarity": {"scale": 4.0, "center": [32, 0, 0]}})
    (tmp_path / "path.json").write_text(json.dumps({"keyframes": POSES}))
    pipeline.render(folder, tmp_path / "film.webm", path=tmp_path / "path.json", seconds=1, fps=5)
    assert pictures_of(tmp_path / "film.webm").shape == (5, 20, 24, 3)
    ends = [viewmat_center(cameras[place].viewmat)[0] for place in (0, -1)]
    np.testing.assert_allclose(ends, [4 * (0 - 32), 4 * (-3 - 32)], atol=1e-4)
    assert cameras[0].K[1, 1] == pytest.approx(10 / np.tan(np.radians(25)))


def test_a_turntable_is_a_folder_a_film_or_a_gif(run, tmp_path):
    folder, cameras = run
    pipeline.render(folder, tmp_path / "turn", views="turntable")
    assert len(cameras) == 36 and len(list((tmp_path / "turn").iterdir())) == 3 * 36
    circle = [viewmat_center(camera.viewmat) for camera in cameras]
    cameras.clear()
    pipeline.render(folder, tmp_path / "turn.gif", views="turntable", seconds=3.6)
    np.testing.assert_allclose([viewmat_center(camera.viewmat) for camera in cameras], circle, atol=0.02)
    pictures, durations = gif_pictures(tmp_path / "turn.gif")
    assert pictures.shape[1:] == (20, 24, 3)
    assert sum(durations) == 3600 and min(durations) == 100


def test_a_mesh_turns_in_its_vertex_colours_or_its_texture(tmp_path, box):
    write_mesh(tmp_path / "m.ply", box)
    one_texel = Atlas(np.zeros_like(box.vertices[:, :2]), np.arange(box.num_vertices, dtype=np.int32), box.faces, 4, 1)
    write_textured(tmp_path / "m.glb", TexturedMesh(box, one_texel, np.full((4, 4, 3), [0, 200, 200], np.uint8)))
    for name, out in (("m.ply", "v.gif"), ("m.glb", "t.gif")):
        options = ["--turntable", "--seconds", "0.3", "--size", "64x32"]
        assert cli.main(["render", str(tmp_path / name), "--out", str(tmp_path / out), *options]) == 0
    colored, textured = (gif_pictures(tmp_path / name)[0] for name in ("v.gif", "t.gif"))
    assert np.shape(colored) == np.shape(textured) == (3, 32, 64, 3)
    for picture in textured:
        assert (picture[[0, -1]] == 255).all() and (picture[:, [0, -1]] == 255).all(), "over white, and not cut off"
        inside = np.abs(picture - [0, 200, 200]).max(axis=-1) <= 2
        assert inside.sum() > 50
    for picture in colored:
        red, blue = ((picture[..., own] > 200) & (picture[..., other] < 60) for own, other in ((0, 2), (2, 0)))
        assert np.nonzero(red)[0].mean() < np.nonzero(blue)[0].mean() - 3, "the red end is up"


def test_a_mesh_has_depth_and_normals_and_is_seen_along_a_path(tmp_path, monkeypatch, box):
    """A camera 4 in front of the box's side at x = 6, which is 1 wide and 3 high."""
    monkeypatch.setattr(viewpoints, "MESH_SIZE", 64)
    write_mesh(tmp_path / "m.ply", box)
    viewmat = np.array([[0, 1, 0, 3], [0, 0, -1, 40], [-1, 0, 0, 10], [0, 0, 0, 1.0]])
    poses = [{"viewmat": (viewmat + shift * np.eye(4, k=3)).tolist(), "fov": 60.0} for shift in (0, 0.1)]
    (tmp_path / "path.json").write_text(json.dumps({"keyframes": poses}))
    options = {"path": tmp_path / "path.json", "seconds": 1, "fps": 1, "size": (64, 64), "what": "normals"}
    pipeline.render(tmp_path / "m.ply", tmp_path / "n.gif", **options)
    picture = gif_pictures(tmp_path / "n.gif")[0][0]
    facing = np.abs(picture - [128, 128, 255]).max(axis=-1) < 4
    # Its distance is 4 and half of its height 1.5, at a focal length of 32 / tan(30 degrees).
    rows, columns = (np.ptp(places) + 1 for places in np.nonzero(facing))
    assert rows == pytest.approx(2 * 55.4 * 1.5 / 4, abs=4) and columns == pytest.approx(55.4 / 4, abs=4)
    pipeline.render(tmp_path / "m.ply", tmp_path / "turn", views="turntable")
    depth, _ = read_image(tmp_path / "turn/turn_000_depth.png")
    assert depth.shape == (64, 64, 3) and (depth[0] == 0).all() and (depth[32, 32] > 0).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "--out", "film.avi", "--through-photos"], "out=film.avi: a film ends in .mp4, .webm, .gif"),
        (["run", "--out", "film.mp4"], "out=film.mp4: a film needs a path: turntable"),
        (["run", "--out", "film.mp4", "--turntable", "--size", "641x480"], "size=641x480: sides are even, and betwe"),
        (["run", "--out", "pictures", "--fps", "10"], "fps is for films, and out=pictures does not end in .mp4"),
        (["m.obj", "--out", "t.gif", "--through-photos"], "m.obj: has fewer than two photos to pass"),
    ],
)
def test_bad_options_are_one_line_and_write_nothing(run, box, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    write_mesh(tmp_path / "m.obj", box)
    before = sorted(tmp_path.iterdir())
    assert cli.main(["render", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


def test_no_two_views_share_a_name():
    assert picture_stems(["a.HEIC", "a.JPG", "b.png"]) == ["a.HEIC", "a.JPG", "b"]
    assert picture_stems(["l/0.png", "l_0.png"]) == ["l_0.png_0", "l_0.png_1"]
    assert picture_stems(["", "..", "../a.png"]) == ["", "..", ".._a"]
