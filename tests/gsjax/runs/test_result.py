"""What a run folder keeps of its views: cameras, and masks instead of photos."""

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import camera_at, cloud

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.images import write_image
from gsjax.io.ply import write_gaussians
from gsjax.rendering import gallery
from gsjax.runs.result import open_result, training_pictures, write_views
from gsjax.runs.run import Run
from gsjax.scene import Frame, Pixels, frame_of

CAMERAS = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0), size=(24, 20)) for x in (-0.5, 0.0, 0.5, 1.0)]
VALID = np.random.default_rng(0).integers(0, 2, (20, 24), np.uint8) * np.uint8(255)


def unreadable():
    raise AssertionError("this photo is not needed")


def frames() -> tuple[Frame, ...]:
    """One that is held out, one with a mask, one whose mask hides nothing, one without: only two need to be read."""
    image = np.zeros((20, 24, 3), np.uint8)
    all_valid = np.full((20, 24), 255, np.uint8)
    masked = [Pixels(image, None, VALID), Pixels(image, None, all_valid)]
    all_frames = [
        frame_of(f"at/{k}.jpg", np.asarray(c.viewmat), np.asarray(c.K), masked[0]) for k, c in enumerate(CAMERAS)
    ]
    return (
        replace(all_frames[0], held_out=True, pixels=unreadable),
        all_frames[1],
        replace(all_frames[2], pixels=lambda: masked[1]),
        replace(all_frames[3], pixels=unreadable, masked=False),
    )


@pytest.fixture
def run(tmp_path):
    write_gaussians(tmp_path / "gaussians.ply", cloud(30))
    json_files.write(tmp_path / "config.json", {"model": {"background": "white"}})
    write_views(tmp_path, frames())
    return tmp_path


def test_a_run_keeps_cameras_and_the_masks_of_training_views_that_hide_something(run):
    assert [path.name for path in (run / "masks").iterdir()] == ["0001.png"]
    result = open_result(run)
    assert result.names == tuple(f"at/{k}.jpg" for k in range(4)) and result.held_out == (True, False, False, False)
    for camera, expected in zip(result.cameras, CAMERAS, strict=True):
        np.testing.assert_array_equal(camera.viewmat, expected.viewmat)
        np.testing.assert_array_equal(camera.K, expected.K)
        assert (camera.width, camera.height) == (24, 20)
    masks = [read() for read in result.valid]
    np.testing.assert_array_equal(masks[1], VALID > 0)
    assert masks[0] is masks[2] is masks[3] is None


def test_training_pictures_are_empty_where_photos_are_masked(run):
    result = open_result(run)
    cameras, pictures = training_pictures(result, result.gaussians, np.ones(3, np.float32))
    masked, whole, _ = pictures
    assert cameras == list(result.cameras[1:])
    for part in masked[:3]:
        assert (part[VALID == 0] == 0).all() and (part[VALID > 0] != 0).any()
    assert np.all(whole.colors.max(axis=-1) > 0)


def test_depth_is_what_it_was_in_training(run):
    """Center in a run of before there was a choice."""
    gaussians = open_result(run).gaussians
    for model, mode in (({}, "center"), ({"depth_mode": "plane"}, "plane")):
        json_files.write(run / "config.json", {"model": {"background": "white"} | model})
        result = open_result(run)
        depth = list(training_pictures(result, result.gaussians, result.background)[1])[1].depth
        (expected,) = gallery.pictures(gaussians, [CAMERAS[2]], np.ones(3), mode)
        np.testing.assert_array_equal(depth, expected.depth)


def test_a_mask_that_cannot_be_used_is_one_line(run):
    write_image(run / "masks/0001.png", VALID[:, :12])
    result = open_result(run)
    with pytest.raises(InputError, match=r"masks/0001.png: mask is 12x20 but its view 24x20"):
        list(training_pictures(result, result.gaussians, result.background)[1])
    (run / "masks/0001.png").unlink()
    with pytest.raises(InputError, match=r"masks/0001.png: no such image"):
        list(training_pictures(result, result.gaussians, result.background)[1])


def test_a_run_whose_cameras_are_none_or_whose_photos_have_no_size_is_one_line(run):
    (run / "cameras.json").write_text("[]")
    with pytest.raises(InputError, match=r"cameras\.json: lists no views"):
        open_result(run)
    json_files.write(run / "plan.json", {"phases": [], "steps": 1, "downscale": 0})
    with pytest.raises(InputError, match="downscale 0, which is not positive"):
        _ = Run(run).downscale
