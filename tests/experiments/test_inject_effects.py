"""Data sets that another camera took: what was put into the photos is what the file says."""

from dataclasses import replace

import numpy as np
import pytest
from photographed_wall import wall, written
from scipy.spatial.transform import Rotation

from gsjax.colors import srgb_to_linear
from gsjax.io import json_files
from gsjax.io.scenes import load_scene
from gsjax.scene import Truth
from gsjax.similarity import IDENTITY


@pytest.fixture
def script(scripts):
    return scripts("inject_effects")


@pytest.fixture
def scene(tmp_path):
    scene = wall(4)
    written(scene, tmp_path / "scene")
    return scene


def test_light_is_changed_by_what_the_file_tells(script, scene, tmp_path):
    out = script.inject(tmp_path / "scene", tmp_path / "out", exposure=0.3, balance=0.1, corner=-0.5)
    told = json_files.read(out / "injected.json")
    np.testing.assert_allclose(np.mean(list(told["gains"].values()), axis=0), 0, atol=1e-12)
    for before, after in zip(scene.frames, load_scene(out, similarity=IDENTITY).frames, strict=True):
        stops = np.log2(srgb_to_linear(after.pixels().image / 255) / srgb_to_linear(before.pixels().image / 255))
        middle, corner = stops[35:37, 47:49].mean((0, 1)), stops[0, 0]
        # A step of 1 / 255 at these tones is 0.03 EV.
        np.testing.assert_allclose(middle, told["gains"][before.name], atol=0.04)
        np.testing.assert_allclose(corner - middle, -0.5, atol=0.07)


def test_poses_are_wrong_by_what_was_asked_and_the_file_tells_the_true_ones(script, scene, tmp_path):
    out = script.inject(tmp_path / "scene", tmp_path / "out", turn=0.5, shift=0.01)
    told = json_files.read(out / "injected.json")["viewmats"]
    errors = []
    for before, after in zip(scene.frames, load_scene(out, similarity=IDENTITY).frames, strict=True):
        np.testing.assert_allclose(told[before.name], before.viewmat, atol=1e-6)
        np.testing.assert_array_equal(after.pixels().image, before.pixels().image)
        errors.append(after.viewmat.astype(np.float64) @ np.linalg.inv(before.viewmat.astype(np.float64)))
    again = load_scene(out, similarity=IDENTITY).frames
    frames = [(b, a) for b, a in zip(scene.frames, again, strict=True) if not a.held_out]
    moves = [np.linalg.inv(a.viewmat)[:3, 3] - np.linalg.inv(b.viewmat)[:3, 3] for b, a in frames]
    np.testing.assert_allclose(np.mean(moves, axis=0), 0, atol=1e-4)  # The world as a whole stays where it is.
    turns = Rotation.from_matrix(np.stack(errors)[:, :3, :3]).as_rotvec(degrees=True)
    shifts = np.stack(errors)[:, :3, 3]
    # Twelve draws of either; the wall is 3 units away.
    assert np.sqrt(np.mean(turns**2)) == pytest.approx(0.5, rel=0.5)
    assert np.sqrt(np.mean(shifts**2)) == pytest.approx(0.03, rel=0.5)


def test_squares_are_pasted_into_some_photos(script, scene, tmp_path):
    out = script.inject(tmp_path / "scene", tmp_path / "out", pasted=0.5)
    changed = []
    for before, after in zip(scene.frames, load_scene(out, similarity=IDENTITY).frames, strict=True):
        other = (after.pixels().image != before.pixels().image).any(-1)
        changed.append(other.mean())
        if other.any():
            assert len(np.unique(after.pixels().image[other], axis=0)) <= script.SQUARES
    assert sorted(share > 0 for share in changed) == [False, False, True, True]
    assert 0.05 < max(changed) <= script.SQUARES * script.SIDE**2 * 1.05


def test_a_sky_is_put_where_the_truth_says_that_there_is_none_else(script, scene):
    frame = scene.frames[0]
    labels = np.ones((72, 96), np.uint8)
    labels[:20] = 0
    true = replace(scene, truth=Truth(labels={frame.name: lambda: labels}))
    found = script._under_sky(true, frame, 1.0).pixels().image
    np.testing.assert_array_equal(found[20:], frame.pixels().image[20:])
    # The cameras look along z: the middle of the picture is the zenith of this world.
    height = 0.5 + 0.5 / np.sqrt(1 + (((0.5 - 48) / 80) ** 2 + ((0.5 - 36) / 80) ** 2))
    expected = 255 * ((1 - height) * script.HORIZON + height * script.ZENITH)
    np.testing.assert_allclose(found[0, 0], expected, atol=0.51)
