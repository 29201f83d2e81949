"""Films of a run: how many pictures, of what, and from where; what cannot be filmed is one line."""

import json

import cv2
import numpy as np
import pytest
from small_scenes import camera_at, cloud

from gsjax import cli, pipeline
from gsjax.cameras import viewmat_center
from gsjax.io import json_files
from gsjax.io.ply import write_gaussians
from gsjax.rendering import gallery
from gsjax.report.pictures import depth_picture, depth_span
from gsjax.runs.result import write_views
from gsjax.scene import Pixels, frame_of

POSES = [{"viewmat": (np.eye(4) + shift * np.eye(4, k=3)).tolist(), "fov": 50.0} for shift in (0, 1, 3)]


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A run of ten cameras along x; what it shows is grey by its place, so nothing is compiled."""
    folder, image = tmp_path / "run", np.zeros((20, 24, 3), np.uint8)
    cameras = [camera_at((x, 0.0, 0.0), (x, 0.0, 4.0), size=(24, 20)) for x in np.linspace(-1, 1, 10)]
    frames = [
        frame_of(f"{k}.jpg", np.asarray(c.viewmat), np.asarray(c.K), Pixels(image)) for k, c in enumerate(cameras)
    ]
    json_files.write(folder / "config.json", {"background": "white"})
    write_gaussians(folder / "gaussians.ply", cloud(30))
    write_views(folder, tuple(frames))
    seen = []

    def drawn(gaussians, cameras, background, depth_mode="plane"):
        for camera in cameras:
            seen.append(camera)
            grey = np.full((camera.height, camera.width), (viewmat_center(camera.viewmat)[0] + 1) / 2, np.float32)
            yield gallery.Picture(np.repeat(grey[..., None], 3, -1), 1 + grey, np.ones_like(grey))

    monkeypatch.setattr(gallery, "pictures", drawn)
    return folder, seen


def pictures_of(path):
    film = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    shown = []
    while (picture := film.read()[1]) is not None:
        shown.append(picture)
    return np.array(shown)


def test_a_flight_past_the_photos_begins_at_the_first_and_ends_at_the_last(run, tmp_path, capsys):
    folder, seen = run
    out = tmp_path / "film.mp4"
    arguments = ["--through-photos", "--seconds", "1.5", "--fps", "10", "--size", "64x48"]
    assert cli.main(["render", str(folder), "--out", str(out), *arguments]) == 0
    assert "frames   15\n" in capsys.readouterr().out
    np.testing.assert_allclose(
        [viewmat_center(camera.viewmat)[0] for camera in seen], np.linspace(-1, 1, 15), atol=1e-4
    )
    shown = pictures_of(out)
    assert shown.shape == (15, 48, 64, 3)
    np.testing.assert_allclose(shown.mean(axis=(1, 2, 3)), np.linspace(0, 255, 15), atol=8)


def test_keyframes_are_in_the_coordinates_of_the_run(run, tmp_path):
    folder, seen = run
    json_files.write(folder / "manifest.json", {"scene": "nowhere", "similarity": {"scale": 4.0, "center": [32, 0, 0]}})
    (tmp_path / "path.json").write_text(json.dumps({"keyframes": POSES}))
    figures = pipeline.film(folder, tmp_path / "film.webm", path=tmp_path / "path.json", seconds=1, fps=5)
    assert (figures["frames"], figures["width"], figures["height"]) == (5, 24, 20)
    ends = [viewmat_center(seen[place].viewmat)[0] for place in (0, -1)]
    np.testing.assert_allclose(ends, [4 * (0 - 32), 4 * (-3 - 32)], atol=1e-4)
    assert seen[0].K[1, 1] == pytest.approx(10 / np.tan(np.radians(25)))


def test_depths_keep_their_grey(run, tmp_path):
    """The same depth is as light in the last picture as in the first, however near the nearest is."""
    folder, _ = run
    pipeline.film(folder, tmp_path / "film.mp4", path="through_photos", what="depth", seconds=1, fps=10, size=(64, 48))
    light = pictures_of(tmp_path / "film.mp4").mean(axis=(1, 2, 3))
    assert (np.diff(light) < 2).all() and light[0] - light[-1] > 150
    depths = np.float32([[0, 1, 2, 3]])
    assert depth_span(depths) == pytest.approx((1.02, 2.98))
    np.testing.assert_array_equal(depth_picture(depths)[0, :, 0], [0, 255, 147, 38])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "film.avi", "--orbit"], "--out film.avi: a film ends in .mp4 or .webm"),
        (["--out", "film.mp4", "--orbit", "--seconds", "0"], "--seconds 0 is not above 0 and 3600 at most"),
        (["--out", "film.mp4", "--orbit", "--fps", "1000"], "--fps 1000 is not above 0 and 240 at most"),
        (["--out", "film.mp4", "--orbit", "--size", "641x480"], "--size 641x480: sides are even, and between 16 and"),
        (["--out", "film.mp4", "--orbit", "--size", "64"], "64: not a size such as 1280x720"),
        (["--out", "film.mp4", "--orbit", "--seconds", "3000"], "are 90000 pictures, more than 36000"),
        (["--out", "film.mp4", "--path", "none.json"], "none.json: cannot be read (No such file or directory)"),
        (["--out", "pictures", "--fps", "10"], "--fps goes with --path, --orbit or --through-photos"),
        (["--out", "run/gaussians.mp4", "--path", "a", "--orbit"], "--orbit: not allowed with argument --path"),
    ],
)
def test_what_cannot_be_filmed_is_one_line(run, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["render", "run", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_film_that_is_stopped_leaves_nothing(run, tmp_path, monkeypatch):
    folder, _ = run

    def stopped(*_, **__):
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(gallery, "pictures", stopped)
    with pytest.raises(KeyboardInterrupt):
        pipeline.film(folder, tmp_path / "film.mp4", seconds=1, fps=5)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
