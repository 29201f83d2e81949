import io
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
from gsjax.io.images import image_size, read_image
from gsjax.io.scenes import load_scene
from gsjax.io.sfm import reconstruct

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

    report = reconstruct(root / "photos", root / "scene", threads=2, progress=progress)
    return root / "scene", report, bars


def test_real_photos_get_the_poses_of_the_reference_model(fox, shared):
    scene, report, _ = fox
    assert (report.images, report.registered) == (6, 6)
    assert report.points > 500 and report.mean_track_length > 2.5 and 0 < report.mean_reprojection_error < 1.2
    assert 0 < report.seconds < 120
    reference = pycolmap.Reconstruction(shared / "data/fox/undistorted/sparse/0")
    frames = load_scene(scene).frames
    theirs = {image.name: image for image in reference.images.values()}
    ours_first, theirs_first = frames[0].viewmat, theirs[frames[0].name].cam_from_world().matrix()
    for frame in frames[1:]:
        relative = frame.viewmat[:3, :3] @ ours_first[:3, :3].T
        expected = theirs[frame.name].cam_from_world().matrix()[:, :3] @ theirs_first[:, :3].T
        angle = np.degrees(np.arccos(np.clip((np.trace(relative @ expected.T) - 1) / 2, -1, 1)))
        assert angle < 1.0  # six photos fix the focal length, and with it the angles, to a few per cent only


def test_the_result_is_an_undistorted_data_set_and_nothing_else(fox):
    scene, report, _ = fox
    assert sorted(p.name for p in scene.iterdir()) == ["images", "sparse"]
    model = pycolmap.Reconstruction(scene / "sparse/0")
    assert {camera.model_name for camera in model.cameras.values()} == {"PINHOLE"}
    assert (model.num_reg_images(), model.num_points3D()) == (report.registered, report.points)
    assert [p.name for p in scene.parent.iterdir() if p.name.startswith(".")] == []
    assert scene.stat().st_mode & 0o055 == scene.parent.joinpath("photos").stat().st_mode & 0o055


def test_every_stage_reports_its_progress_to_the_end(fox):
    _, _, bars = fox
    assert [bar.desc for bar in bars] == ["features", "matching", "mapping", "undistortion"]
    assert [(bar.n, bar.total) for bar in bars] == [(6, 6), (15, 15), (6, 6), (6, 6)]


def test_many_photos_are_matched_along_their_names(shared, tmp_path, monkeypatch):
    monkeypatch.setattr(sfm, "_EXHAUSTIVE_UP_TO", 3)
    (tmp_path / "photos").mkdir()
    for file in sorted((shared / "data/fox/images").iterdir())[:6]:
        shutil.copy(file, tmp_path / "photos")
    # One thread: with more, COLMAP ends elsewhere every time, and now and then without the last photo.
    assert reconstruct(tmp_path / "photos", tmp_path / "scene", threads=1, progress=quietly).registered == 6


def test_photos_that_show_nothing_in_common_are_counted(tmp_path):
    photos = noise_photos(tmp_path / "photos", 3)
    with pytest.raises(InputError, match=r"photos: no model found; 0 of 3 photos match another one"):
        reconstruct(photos, tmp_path / "scene", progress=quietly)
    assert [p.name for p in tmp_path.iterdir()] == ["photos"]


def test_unusable_photos_are_named(tmp_path):
    with pytest.raises(InputError, match="no such folder of photos"):
        reconstruct(tmp_path / "nowhere", tmp_path / "scene", progress=quietly)
    photos = noise_photos(tmp_path / "photos", 1)
    (photos / "notes.txt").write_text("not a photo")
    with pytest.raises(InputError, match=r"photos: needs at least 2 photos .*, has 1"):
        reconstruct(photos, tmp_path / "scene", progress=quietly)
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


def test_an_interrupt_leaves_nothing_behind(tmp_path):
    photos = noise_photos(tmp_path / "photos", 3)

    class Interrupted(tqdm):
        def update(self, n=1):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct(photos, tmp_path / "scene", progress=partial(Interrupted, disable=True))
    assert [p.name for p in tmp_path.iterdir()] == ["photos"]


def test_exif_rotation_is_ignored_by_the_reader_as_by_colmap(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned by 90 degrees for display
    left_half_white = np.zeros((20, 40, 3), np.uint8)
    left_half_white[:, :20] = 255
    Image.fromarray(left_half_white).save(tmp_path / "turned.jpg", exif=exif, quality=95)
    ours, _ = read_image(tmp_path / "turned.jpg")
    theirs = pycolmap.Bitmap.read(str(tmp_path / "turned.jpg"), True).to_array()
    assert image_size(tmp_path / "turned.jpg") == (40, 20) and ours.shape == theirs.shape == (20, 40, 3)
    assert np.abs(ours.astype(int) - theirs).max() <= 3
    assert np.abs(ours.astype(int) - left_half_white).max() <= 12
