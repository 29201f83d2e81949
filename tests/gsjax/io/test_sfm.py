"""Reconstruction of real photos, and the focal lengths of EXIF that it starts from."""

import os
import shutil
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io.images import read_image
from gsjax.io.scenes import load_scene
from gsjax.io.sfm import initial_cameras, mapping, reconstruct, source_photos
from gsjax.io.sfm.source_photos import list_source_photos

quietly = partial(tqdm, disable=True)


def noise_photos(folder, count, size=(64, 48)):
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for i in range(count):
        cv2.imwrite(str(folder / f"{i}.png"), rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8))
    return folder


def save_turned(source, target, turns, orientation=None):
    """A photo with its stored pixels turned clockwise by quarter turns, and a tag where one is given."""
    pixels, _ = read_image(source)
    exif = Image.Exif()
    if orientation:
        exif[0x0112] = orientation
    Image.fromarray(np.ascontiguousarray(np.rot90(pixels, -turns))).save(target, quality=95, exif=exif)


@pytest.fixture(scope="module")
def photos(shared):
    """Six neighbouring real photos."""
    return sorted((shared / "data/fox/images").iterdir())[:6]


@pytest.fixture(scope="module")
def fox(photos, tmp_path_factory):
    """The reconstruction of photos held upright and across, its report, and the quarter turns of those held across."""
    root = tmp_path_factory.mktemp("sfm")
    (root / "photos").mkdir()
    turns = {}
    for number, source in enumerate(photos):
        target = root / "photos" / source.name
        match number % 4:
            case 0:
                shutil.copy(source, target)
            case 1:
                save_turned(source, target, turns=3, orientation=6)  # as phones store what was held upright
            case 2:
                save_turned(source, target, turns=1, orientation=8)
            case 3:
                save_turned(source, target, turns=3)  # as if it had been held across
                turns[source.name] = 3
    return root / "scene", reconstruct(root / "photos", root / "scene", progress=quietly), turns


def test_real_photos_get_the_poses_of_the_reference_model(fox, shared):
    """Within a degree: six photos fix the focal length, and with it the angles, to a few per cent only."""
    scene, report, turns = fox
    assert (report.images, report.registered, report.left_out) == (6, 6, {})
    assert report.points > 500 and report.mean_track_length > 2.5 and 0 < report.mean_reprojection_error < 1.2
    assert 0 < report.seconds < 120
    reference = pycolmap.Reconstruction(shared / "data/fox/undistorted/sparse/0")
    theirs = {image.name: image.cam_from_world().matrix()[:, :3] for image in reference.images.values()}
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    frames = load_scene(scene).frames
    expected = [np.linalg.matrix_power(turn, turns.get(frame.name, 0)) @ theirs[frame.name] for frame in frames]
    for frame, rotation in zip(frames[1:], expected[1:], strict=True):
        ours = frame.viewmat[:3, :3] @ frames[0].viewmat[:3, :3].T
        off = ours @ (rotation @ expected[0].T).T
        angle = np.degrees(np.arccos(np.clip((np.trace(off) - 1) / 2, -1, 1)))
        assert angle < 1, frame.name


def test_photos_held_upright_and_across_share_a_camera_and_come_out_upright(fox, photos):
    scene, _, turns = fox
    model = pycolmap.Reconstruction(scene / "sparse/0")
    across, *upright = sorted(model.cameras.values(), key=lambda camera: -camera.width)
    assert len(upright) == 2  # The device stood on its one side, or on the other.
    for camera in upright:
        assert (camera.width, camera.height) == (across.height, across.width)
        np.testing.assert_array_equal(camera.params[:2], across.params[1::-1])
    for source in photos:
        photo_path = scene / "images" / source.name
        with Image.open(photo_path) as picture:
            assert 0x0112 not in picture.getexif()
        pixels, _ = read_image(photo_path)
        expected = np.rot90(read_image(source)[0], -turns.get(source.name, 0))
        expected = cv2.resize(expected, pixels.shape[1::-1])
        assert np.abs(pixels.astype(int) - expected).mean() < 12
        assert np.abs(pixels[::-1, ::-1].astype(int) - expected).mean() > 30  # so that the test can fail


def test_the_result_is_an_undistorted_data_set_and_a_report_of_it(fox):
    scene, report, _ = fox
    assert sorted(p.name for p in scene.iterdir()) == ["images", "sfm.json", "sparse"]
    model = pycolmap.Reconstruction(scene / "sparse/0")
    assert {camera.model_name for camera in model.cameras.values()} == {"PINHOLE"}
    assert (model.num_reg_images(), model.num_points3D()) == (report.registered, report.points)
    assert [p.name for p in scene.parent.iterdir() if p.name.startswith(".")] == []
    assert scene.stat().st_mode & 0o055 == scene.parent.joinpath("photos").stat().st_mode & 0o055


def test_points_have_the_colours_of_the_photos(fox):
    scene, _, _ = fox
    model = pycolmap.Reconstruction(scene / "sparse/0")
    image = model.image(1)
    pixels, _ = read_image(scene / "images" / image.name)
    size = pixels.shape[1::-1]
    # Features of the border lie outside the undistorted photo.
    observations = [p for p in image.points2D if p.has_point3D() and all(0 <= p.xy[k] < size[k] for k in range(2))]
    assert len(observations) > 50
    here = np.array([pixels[int(point.xy[1]), int(point.xy[0])] for point in observations], float)
    colors = np.array([model.point3D(point.point3D_id).color for point in observations], float)
    assert np.median(np.abs(colors - here)) < 10


def test_what_cannot_be_meant_is_refused(tmp_path):
    photos = noise_photos(tmp_path / "photos", 2)
    with pytest.raises(InputError, match="is a folder of photos, of which all are taken"):
        reconstruct(photos, tmp_path / "scene", frames=5)
    with pytest.raises(InputError, match="0.png: is one photo"):
        reconstruct(photos / "0.png", tmp_path / "scene", progress=quietly)
    with pytest.raises(InputError, match="no such folder of photos"):
        list_source_photos(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"photos: needs at least 2 photos .*, has 1"):
        list_source_photos(noise_photos(tmp_path / "one/photos", 1))
    with pytest.raises(InputError, match="frames=1: at least 2"):
        reconstruct(photos / "0.png", tmp_path / "scene", frames=1)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one", "photos"]
    for out, message in ((tmp_path / "one", "exists and is not empty"), (photos / "0.png/below", "cannot write")):
        with pytest.raises(InputError, match=message):
            reconstruct(photos, out, progress=quietly)
    assert os.listdir(tmp_path / "one") == ["photos"] and (photos / "0.png").is_file()


def test_frames_of_a_video_that_show_nothing_in_common_are_counted(tmp_path):
    writer = cv2.VideoWriter(str(tmp_path / "clip.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25, (64, 48))
    for photo in noise_photos(tmp_path / "photos", 6).iterdir():
        writer.write(cv2.imread(str(photo)))
    writer.release()
    with pytest.raises(InputError, match=r"clip.avi: no model found; 0 of 3 photos match another one"):
        reconstruct(tmp_path / "clip.avi", tmp_path / "scene", frames=3, progress=quietly)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["clip.avi", "photos"]


SIZE = (300, 200)
PIXELS_A_MM = np.hypot(*SIZE) / np.hypot(36, 24)  # of 35 mm film


def photo(path, film=None, zoom=None, make="Maker", lens=4.2):
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = make, "Phone 1"
    details = exif.get_ifd(0x8769)
    for tag, value in ((0xA405, film), (0xA404, zoom), (0x920A, lens)):
        if value is not None:
            details[tag] = value
    pixels = np.random.default_rng(0).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path, exif=exif)


def priors_of(folder, *photos):
    """The prior focal length of each photo, mm of 35 mm film, None where there is none; and why some are ignored."""
    for number, tags in enumerate(photos):
        photo(folder / f"{number}.jpg", **tags)
    shots = source_photos.list_source_photos(folder)
    priors, ignored = initial_cameras.focal_priors(shots)
    cameras = initial_cameras.guess_cameras(shots, priors)
    focals = [camera.mean_focal_length() / PIXELS_A_MM if camera.has_prior_focal_length else None for camera in cameras]
    return focals, ignored


PHONE = {"film": 45, "zoom": 1.6}


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        ([{"film": 28, "zoom": zoom} for zoom in (None, 1.0, IFDRational(0, 0), 1.6)], [28, 28, 28, 1.6 * 28]),
        ([{"film": 28, "zoom": 1.0}, PHONE, {"film": 84, "zoom": 3.0}], [28, 45, 84]),  # It includes the zoom.
        ([{"film": 28, "zoom": 2.0}, {"film": 28, "zoom": 1.6}], [56, 44.8]),  # No photo is without zoom.
        ([PHONE | {"make": "Apple"}, PHONE, {"film": 20, "lens": 2.2}], [45, None, 20]),
        ([{"film": 7}, {"film": 400, "lens": 90.0}], [None, 400]),
    ],
    ids=["constant", "includes zoom", "all zoomed", "unknown", "out of range"],
)
def test_focal_lengths_for_35_mm_film_with_and_without_digital_zoom(tmp_path, tags, expected):
    """By what other photos of the camera show; an iPhone includes the zoom. Those of no lens are ignored and named."""
    focals, ignored = priors_of(tmp_path, *tags)
    np.testing.assert_allclose(np.array(focals, float), np.array(expected, float), rtol=1e-3)
    assert list(ignored) == [f"{index}.jpg" for index, focal in enumerate(expected) if focal is None]
    assert all("mm of 35 mm film" in reason for reason in ignored.values())


def fake_model(registered, points=100):
    return SimpleNamespace(num_reg_images=lambda: registered, num_points3D=lambda: points)


@pytest.mark.parametrize(
    ("models", "index", "line"),
    [
        ([10], 0, ""),
        ([9, 4], 0, "9 of 20 photos get a pose with the focal lengths of EXIF, 4 without them; the model with them"),
        ([None, 6], 1, "0 of 20 photos get a pose with the focal lengths of EXIF, 6 without them; the model without"),
    ],
)
def test_mapping_runs_again_without_priors_where_less_than_half_register(tmp_path, monkeypatch, models, index, line):
    outcomes = [InputError("no model found") if count is None else (fake_model(count), {}) for count in models]
    map_photos = Mock(side_effect=outcomes)
    monkeypatch.setattr(mapping, "map_photos", map_photos)
    for number in range(20):
        photo(tmp_path / f"{number:02d}.jpg", film=135)
    shots = source_photos.list_source_photos(tmp_path)
    priors, _ = initial_cameras.focal_priors(shots)
    material = mapping.Material(shots, [], np.zeros((20, 20)), [])
    model, _, note = mapping.map_photos_with_priors(material, priors, tmp_path / "work", quietly)
    starts = [call.args[0].cameras[0].has_prior_focal_length for call in map_photos.call_args_list]
    assert starts == [True, False][: len(models)]
    assert model is outcomes[index][0]
    assert note.startswith(line) and bool(note) == bool(line)
    map_photos.side_effect = InputError("no model found")
    with pytest.raises(InputError, match="no model found"):
        mapping.map_photos_with_priors(material, priors, tmp_path / "again", quietly)
