"""What `gsjax undistort` writes is a data set with the same frames."""

import os
from functools import partial

import numpy as np
import pytest
from PIL import Image
from tqdm import tqdm
from transforms_scenes import write_transforms

from gsjax import pipeline
from gsjax.errors import InputError
from gsjax.io.scenes import load_scene


@pytest.fixture(autouse=True)
def silent(monkeypatch):
    monkeypatch.setitem(pipeline.undistort.__globals__, "tqdm", partial(tqdm, disable=True))


def noise(height=30, width=40, channels=3, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)


def assert_same(actual, frames, *, most=0):
    """Frames equal, their pixels to within `most` levels."""
    assert len(actual) == len(frames)
    for ours, theirs in zip(actual, frames, strict=True):
        assert (ours.width, ours.height, ours.held_out) == (theirs.width, theirs.height, theirs.held_out)
        np.testing.assert_array_equal(ours.K, theirs.K)
        np.testing.assert_allclose(ours.viewmat, theirs.viewmat, atol=1e-6)
        for part, other in zip(ours.pixels(), theirs.pixels(), strict=True):
            assert (part is None) == (other is None)
            if part is not None:
                assert np.abs(part.astype(int) - other).max() <= most


def test_distorted_masked_photos_come_back_as_the_same_frames(tmp_path):
    lens = {"fl_x": 35.0, "fl_y": 36.0, "cx": 21.0, "cy": 14.0, "w": 40, "h": 30, "k1": 0.1}
    photos = {f"images/sub/{i:03d}.png": noise(seed=i) for i in range(9)}
    scene = write_transforms(tmp_path / "scene", photos, **lens)
    mask = np.full((30, 40), 255, np.uint8)
    mask[5:15, 20:] = 0
    (scene / "masks/sub").mkdir(parents=True)
    Image.fromarray(mask).save(scene / "masks/sub/004.png")

    report = pipeline.undistort(scene, tmp_path / "out", downscale=2)

    assert report == {"images": 9, "held_out": 2, "masks": 1, "points": 30_000}
    before, after = load_scene(scene, downscale=2), load_scene(tmp_path / "out")
    assert after.source == "colmap"
    assert [f.name for f in after.frames] == [f.name for f in before.frames]
    assert (before.frames[0].width, before.frames[0].height) != (40, 30) and before.frames[0].origin is not None
    assert all(f.origin is None for f in after.frames)
    assert_same(after.frames, before.frames)
    np.testing.assert_array_equal(after.points, before.points)
    np.testing.assert_array_equal(after.point_colors, before.point_colors)


def test_a_layouts_own_split_and_its_mattes_are_kept(tmp_path):
    pictures = {name: noise(channels=4, seed=seed) for seed, name in enumerate("abc")}
    scene = tmp_path / "scene"
    write_transforms(
        scene, {f"train/{n}.png": p for n, p in pictures.items()}, "transforms_train.json", camera_angle_x=0.8
    )
    write_transforms(scene, {"test/a.png": noise(channels=4, seed=9)}, "transforms_test.json", camera_angle_x=0.8)
    pipeline.undistort(scene, tmp_path / "out")
    before, after = load_scene(scene), load_scene(tmp_path / "out")
    assert [f.name for f in after.held_out_frames] == ["test/a.png"]
    assert_same(after.frames, before.frames)
    assert (tmp_path / "out/hold_out.txt").read_text() == "test/a.png\n"


def test_jpegs_stay_jpegs_and_other_formats_become_png(tmp_path):
    smooth = np.repeat(np.arange(0, 240, 6, dtype=np.uint8)[None, :, None], 30, 0).repeat(3, 2)
    photos = {"images/a.JPG": smooth, "images/b.bmp": noise(), "images/c.jpeg": smooth}
    scene = write_transforms(tmp_path / "scene", photos, fl_x=50.0, w=40, h=30)
    pipeline.undistort(scene, tmp_path / "out")
    assert sorted(os.listdir(tmp_path / "out/images")) == ["a.JPG", "b.png", "c.jpeg"]
    assert not (tmp_path / "out/masks").exists()
    assert_same(load_scene(tmp_path / "out").frames, load_scene(scene).frames, most=3)
    photos["images/b.png"] = noise()
    scene = write_transforms(tmp_path / "twice", photos, fl_x=50.0, w=40, h=30)
    with pytest.raises(InputError, match="twice: two of its photos would both be written as b.png"):
        pipeline.undistort(scene, tmp_path / "never")


def test_nothing_is_written_outside_or_left_half_done(tmp_path):
    scene = write_transforms(tmp_path / "scene", {"../photos/a.png": noise(), "images/b.png": noise()}, fl_x=50.0)
    before = (tmp_path / "photos/a.png").stat().st_mtime_ns
    pipeline.undistort(scene, tmp_path / "out")
    paths = sorted(path.relative_to(tmp_path / "out/images") for path in (tmp_path / "out/images").rglob("*.png"))
    assert len(paths) == 2 and paths[-1].name == "a.png"
    assert (tmp_path / "photos/a.png").stat().st_mtime_ns == before
    with pytest.raises(InputError, match="out: exists and is not empty"):
        pipeline.undistort(scene, tmp_path / "out")
    (scene / "images/b.png").write_bytes((scene / "images/b.png").read_bytes()[:500])
    with pytest.raises(InputError, match="b.png: not a whole image .* 1 of 2 photos cannot be used, and 2 are needed"):
        pipeline.undistort(scene, tmp_path / "again")
    assert sorted(os.listdir(tmp_path)) == ["out", "photos", "scene"]
