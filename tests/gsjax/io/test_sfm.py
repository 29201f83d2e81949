import io
import os
import shutil
from functools import partial

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io import sfm
from gsjax.io.images import read_image
from gsjax.io.scenes import load_scene
from gsjax.io.sfm import reconstruct
from gsjax.io.sfm.source_photos import list_source_photos

quietly = partial(tqdm, disable=True)


def noise_photos(folder, count, size=(64, 48)):
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for i in range(count):
        cv2.imwrite(str(folder / f"{i}.png"), rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8))
    return folder


@pytest.fixture(scope="module")
def fox(shared, tmp_path_factory):
    """Six neighbouring real photos, reconstructed."""
    root = tmp_path_factory.mktemp("sfm")
    (root / "photos").mkdir()
    for file in sorted((shared / "data/fox/images").iterdir())[:6]:
        shutil.copy(file, root / "photos")
    bars = []

    def progress(**settings):
        bars.append(tqdm(**settings, file=io.StringIO()))
        return bars[-1]

    report = reconstruct(root / "photos", root / "scene", progress=progress)
    return root / "scene", report, bars


def check_poses(scene, shared, turns=None, tolerance=1.0):
    """Relative rotations agree with the reference model's; `turns` by name: quarter turns clockwise of a picture."""
    reference = pycolmap.Reconstruction(shared / "data/fox/undistorted/sparse/0")
    theirs = {image.name: image.cam_from_world().matrix()[:, :3] for image in reference.images.values()}
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    frames = load_scene(scene).frames
    expected = [np.linalg.matrix_power(turn, (turns or {}).get(f.name, 0)) @ theirs[f.name] for f in frames]
    for frame, rotation in zip(frames[1:], expected[1:], strict=True):
        ours = frame.viewmat[:3, :3] @ frames[0].viewmat[:3, :3].T
        off = ours @ (rotation @ expected[0].T).T
        angle = np.degrees(np.arccos(np.clip((np.trace(off) - 1) / 2, -1, 1)))
        assert angle < tolerance, frame.name


def test_real_photos_get_the_poses_of_the_reference_model(fox, shared):
    scene, report, _ = fox
    assert (report.images, report.registered, report.left_out) == (6, 6, {})
    assert report.points > 500 and report.mean_track_length > 2.5 and 0 < report.mean_reprojection_error < 1.2
    assert 0 < report.seconds < 120
    check_poses(scene, shared)  # six photos fix the focal length, and with it the angles, to a few per cent only


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


def save_turned(source, target, turns, orientation=None):
    """A photo with its stored pixels turned clockwise by quarter turns, and a tag where one is given."""
    pixels, _ = read_image(source)
    exif = Image.Exif()
    if orientation:
        exif[0x0112] = orientation
    Image.fromarray(np.ascontiguousarray(np.rot90(pixels, -turns))).save(target, quality=95, exif=exif)


def test_photos_held_upright_and_across_share_a_camera_and_come_out_upright(shared, tmp_path):
    (tmp_path / "photos").mkdir()
    turns = {}
    for number, source in enumerate(sorted((shared / "data/fox/images").iterdir())[:6]):
        target = tmp_path / "photos" / source.name
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
    report = reconstruct(tmp_path / "photos", tmp_path / "scene", progress=quietly)
    assert report.registered == 6
    model = pycolmap.Reconstruction(tmp_path / "scene/sparse/0")
    across, *upright = sorted(model.cameras.values(), key=lambda camera: -camera.width)
    assert len(upright) == 2  # The device stood on its one side, or on the other.
    for camera in upright:
        assert (camera.width, camera.height) == (across.height, across.width)
        np.testing.assert_array_equal(camera.params[:2], across.params[1::-1])
    check_poses(tmp_path / "scene", shared, turns)
    for source in sorted((shared / "data/fox/images").iterdir())[:6]:
        photo_path = tmp_path / "scene/images" / source.name
        with Image.open(photo_path) as picture:
            assert 0x0112 not in picture.getexif()
        pixels, _ = read_image(photo_path)
        expected = np.rot90(read_image(source)[0], -turns.get(source.name, 0))
        expected = cv2.resize(expected, pixels.shape[1::-1])
        assert np.abs(pixels.astype(int) - expected).mean() < 12
        assert np.abs(pixels[::-1, ::-1].astype(int) - expected).mean() > 30  # so that the test can fail


def test_a_video_becomes_a_data_set_of_its_sharpest_frames(shared, tmp_path):
    sharp = [cv2.imread(str(source)) for source in sorted((shared / "data/fox/images").iterdir())[:6]]
    frames = [frame for image in sharp for frame in (cv2.GaussianBlur(image, (0, 0), 3), image, image // 4)]
    writer = cv2.VideoWriter(str(tmp_path / "clip.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25, (270, 480))
    for frame in frames:
        writer.write(frame)
    writer.release()
    report = reconstruct(tmp_path / "clip.avi", tmp_path / "scene", frames=6, progress=quietly)
    assert (report.images, report.registered) == (6, 6)
    assert sorted(p.name for p in (tmp_path / "scene/images").iterdir()) == [f"{3 * i + 1:06d}.jpg" for i in range(6)]


def crash(*_):
    os.abort()


def test_a_crash_is_one_line_and_leaves_nothing_behind(tmp_path, monkeypatch):
    photos = noise_photos(tmp_path / "photos", 2)
    monkeypatch.setattr(sfm, "_build", crash)
    with pytest.raises(InputError, match=r"photos: the process was ended by SIGABRT") as raised:
        reconstruct(photos, tmp_path / "scene", progress=quietly)
    assert "\n" not in str(raised.value)
    assert [p.name for p in tmp_path.iterdir()] == ["photos"]


def test_what_cannot_be_meant_is_refused(tmp_path):
    photos = noise_photos(tmp_path / "photos", 2)
    with pytest.raises(InputError, match="is a folder of photos, of which all are taken"):
        reconstruct(photos, tmp_path / "scene", frames=5)
    with pytest.raises(InputError, match="0.png: is one photo"):
        reconstruct(photos / "0.png", tmp_path / "scene", progress=quietly)
    with pytest.raises(InputError, match="--frames 1: at least 2"):
        reconstruct(photos / "0.png", tmp_path / "scene", frames=1)
    (tmp_path / "clip.mp4").write_bytes(b"no video")
    with pytest.raises(InputError, match="clip.mp4: not a video that can be read"):
        reconstruct(tmp_path / "clip.mp4", tmp_path / "scene", progress=quietly)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["clip.mp4", "photos"]


def test_photos_that_show_nothing_in_common_are_counted(tmp_path):
    photos = noise_photos(tmp_path / "photos", 3)
    with pytest.raises(InputError, match=r"photos: no model found; 0 of 3 photos match another one"):
        reconstruct(photos, tmp_path / "scene", progress=quietly)
    assert [p.name for p in tmp_path.iterdir()] == ["photos"]


def test_unusable_photos_are_named(tmp_path):
    with pytest.raises(InputError, match="no such folder of photos"):
        list_source_photos(tmp_path / "nowhere")
    photos = noise_photos(tmp_path / "photos", 1)
    (photos / "notes.txt").write_text("not a photo")
    with pytest.raises(InputError, match=r"photos: needs at least 2 photos .*, has 1"):
        list_source_photos(photos)
    (photos / "broken.jpg").write_bytes(b"\xff\xd8\xff\xe0 no more")
    with pytest.raises(InputError, match=r"broken.jpg: not a whole image"):
        reconstruct(photos, tmp_path / "scene", progress=quietly)


def test_a_folder_in_use_is_left_alone(tmp_path):
    photos = noise_photos(tmp_path / "photos", 2)
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene/precious").write_text("kept")
    with pytest.raises(InputError, match="exists and is not empty"):
        reconstruct(photos, tmp_path / "scene", progress=quietly)
    with pytest.raises(InputError, match="cannot write"):
        reconstruct(photos, tmp_path / "scene/precious/below", progress=quietly)
    assert (tmp_path / "scene/precious").read_text() == "kept"
