"""Every detector on a wall painted in closed form, on the built-in scene and on real photos."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from photographed_wall import gains, radii2, relit, turned, wall
from scipy import ndimage
from small_scenes import built_in

from gsjax import cli
from gsjax.effects.diagnosis import diagnose
from gsjax.effects.observations import observe
from gsjax.effects.photo_gains import fit, table
from gsjax.effects.poses import Move, twists_from_tracks
from gsjax.io import normal_folders
from gsjax.io.images import read_image
from gsjax.io.scenes import load_scene
from gsjax.pipeline.diagnose import apart_line
from gsjax.runs.result import frame_camera
from gsjax.scene import with_pixels
from gsjax.scene.cameras import pixel_rays
from gsjax.settings import EFFECTS

FIELDS = ["on", "evidence", "unit", "noise", "threshold", "note", "is_certain"]


def middle(frame) -> float:
    """The column that shows the middle of the wall."""
    return frame.K[0, 2] + frame.viewmat[0, 3] * frame.K[0, 0] / frame.viewmat[2, 3]


def test_a_clean_scene_calls_for_nothing():
    record = diagnose(wall()).record()
    assert list(record["effects"]) == list(EFFECTS)
    assert all(list(effect) == FIELDS for effect in record["effects"].values())
    assert [name for name, effect in record["effects"].items() if effect["on"]] == []
    assert list(record["photos"][0]) == ["name", "gains", "sharpness", "pose_step_px", "sky"]
    assert record["effects"]["exposure"]["evidence"] < 0.01


@pytest.mark.parametrize(("exposure", "balance"), [(0.3, 0.1), (0.0, 0.15)])
def test_gains_are_found_as_they_were_injected(exposure, balance):
    scene = wall()
    true = gains(scene, exposure, balance)
    diagnosis = diagnose(relit(scene, lambda index, *_: true[index]))
    assert diagnosis.effects["exposure"].on
    assert not diagnosis.effects["vignetting"].on
    np.testing.assert_allclose(diagnosis.gains.fit.gains, true, atol=0.02)
    assert diagnosis.effects["exposure"].value == pytest.approx(true.mean(1).std(), abs=0.01)


def test_lamps_over_halves_of_a_scene_are_no_exposure():
    """What brightens each half by its own factor is not one number a photo."""
    scene = wall()
    left, right = gains(scene, 0.5, seed=1), gains(scene, 0.5, seed=5)

    def lamps(index, frame, x, y):
        return np.where((x < middle(frame))[..., None], left[index], right[index])

    exposure = diagnose(relit(scene, lamps)).effects["exposure"]
    assert exposure.value > exposure.threshold
    assert not exposure.on


def test_the_fall_off_is_found_beside_gains():
    scene = wall()
    true = gains(scene, 0.3)
    dark = relit(scene, lambda index, frame, x, y: true[index] - 0.5 * radii2(frame, x, y))
    diagnosis = diagnose(dark)
    assert diagnosis.effects["vignetting"].on
    assert diagnosis.effects["vignetting"].value == pytest.approx(0.5, abs=0.04)
    assert diagnosis.effects["exposure"].on
    bright = relit(scene, lambda index, frame, x, y: 0.5 * radii2(frame, x, y))
    assert not diagnose(bright).effects["vignetting"].on  # No lens does that.


def test_a_fall_off_of_the_later_photos_alone_is_found_and_named():
    scene = wall(24)
    half = relit(scene, lambda index, frame, x, y: -0.6 * radii2(frame, x, y) * (index >= 12))
    vignetting = diagnose(half).effects["vignetting"]
    assert vignetting.on and vignetting.value == pytest.approx(0.6, abs=0.06)
    assert "changes over time: earlier photos" in vignetting.note
    steady = relit(scene, lambda index, frame, x, y: -0.6 * radii2(frame, x, y))
    assert "changes over time" not in diagnose(steady).effects["vignetting"].note


def test_the_robust_fit_is_the_least_squares_one_without_outliers():
    rng = np.random.default_rng(0)
    photo, point = (part.ravel() for part in np.meshgrid(np.arange(5), np.arange(30)))
    is_observed = rng.random(len(photo)) < 0.8
    photo, point = photo[is_observed], point[is_observed]
    true = rng.normal(size=(5, 3))
    values = true[photo] + rng.normal(size=(30, 3))[point]
    solution = fit(table(values, photo, point, 5))
    np.testing.assert_allclose(solution.gains, true - true.mean(0), atol=1e-4)
    values[::9] += 5.0
    np.testing.assert_allclose(fit(table(values, photo, point, 5)).gains, true - true.mean(0), atol=0.02)


def test_a_photo_that_few_tracks_tell_of_is_not_tinted():
    """Fifteen photos that many points tell of, one with five keypoints on a wall that shines red, and one with none."""
    rng = np.random.default_rng(0)
    photo, point = (part.ravel() for part in np.meshgrid(np.arange(16), np.arange(200)))
    is_observed = (photo < 15) | (point < 5)
    photo, point = photo[is_observed], point[is_observed]
    exposure, balance = 0.3 * rng.normal(size=16), 0.02 * rng.normal(size=(16, 3))
    true = exposure[:, None] + balance
    values = true[photo] + rng.normal(size=(200, 3))[point] + 0.05 * rng.normal(size=(len(photo), 3))
    values[photo == 15] += [0.25, 0.0, 0.0]
    estimated_gains = fit(table(values, photo, point, 17)).gains
    np.testing.assert_array_equal(estimated_gains[16], 0)
    assert np.ptp(estimated_gains[15]) < 0.05, "tinted by what five keypoints say"
    true = true[:15] - true[:15].mean(0)
    np.testing.assert_allclose(estimated_gains[:15] - estimated_gains[:15].mean(0), true, atol=0.02)


def test_wrong_poses_show_against_the_tracks():
    scene, off = wall(), turned(wall(), 0.5, seed=2)
    diagnosis = diagnose(off)
    assert diagnosis.effects["poses"].on
    # Half a degree about x and y moves a picture by 0.5 deg * focal length; the median of a Rayleigh is 1.18 of it.
    assert np.median([step.shift for step in diagnosis.steps]) == pytest.approx(1.18 * np.radians(0.5) * 80, rel=0.5)
    assert diagnose(scene).effects["poses"].value < 0.01
    # What tracks ask of each camera brings it back: to second order in a turn of half a degree.
    twists = twists_from_tracks(observe(off))
    for frame, true, twist in zip(off.frames, scene.frames, twists, strict=True):
        viewmat = Move(tuple(twist[:3]), tuple(twist[3:]), 1.0).apply(frame).viewmat
        assert np.abs(viewmat - true.viewmat).max() < 0.05 * np.abs(frame.viewmat - true.viewmat).max()
    assert np.abs(twists_from_tracks(observe(scene))).max() < 1e-5  # rounding of the keypoints


def test_what_cannot_be_judged_says_so():
    effects = diagnose(replace(wall(), tracks=None)).effects
    unknown = {"exposure", "vignetting", "background", "poses", "transients", "sky"}
    assert {name for name, evidence in effects.items() if evidence.value is None} == unknown
    assert all("cannot be judged" in effects[name].note and not effects[name].on for name in unknown)


@pytest.mark.parametrize(("name", "exposure", "vignetting"), [("kitchen", 0.33, True), ("fern", 0.03, False)])
def test_real_photos_fall_into_their_two_groups(shared, name, exposure, vignetting):
    scene = load_scene(shared / "data" / name)
    effects = diagnose(scene).effects
    assert effects["exposure"].value == pytest.approx(exposure, abs=0.05)
    assert effects["exposure"].on == (exposure > 0.1)
    assert effects["vignetting"].on == vignetting
    assert "changes over time" not in effects["vignetting"].note
    assert not effects["sky"].on and not effects["blur"].on

    def soft(frame):
        image = ndimage.gaussian_filter(frame.pixels().image, (2, 2, 0))
        return with_pixels(frame, frame.pixels()._replace(image=image))

    blur = diagnose(replace(scene, frames=tuple(map(soft, scene.frames[::4])))).effects["blur"]
    assert blur.on and "all photos are blurred" in blur.note


def test_the_command_prints_the_table_writes_file_and_pictures_and_judges_maps_of_normals(tmp_path, capsys):
    """True maps are kept; those that face their cameras everywhere look plausible, and say nothing."""
    root, target = built_in(tmp_path / "scene", num_views=9, size=(48, 40)), tmp_path / "out" / "found.json"
    scene = load_scene(root)
    for name in ("true", "facing"):
        folder = root / f"normals_{name}"
        folder.mkdir()
        manifest = normal_folders.begin(folder, {"network": name})
        for frame in scene.frames:
            facing = -np.asarray(pixel_rays(frame_camera(frame)))
            normals = scene.truth.normals[frame.name]() if name == "true" else facing
            normal_folders.add(folder, manifest, frame.name, Path(frame.name).with_suffix(".npz"), normals, {})
    assert cli.main(["diagnose", str(root), "--json", str(target)]) == 0
    *printed, head, facing_row, true_row = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [words[0] for words in printed[: len(EFFECTS) + 1]] == ["effect", *EFFECTS]
    assert head[:2] == ["normals", "decision"]
    assert (facing_row[:2], true_row[:2]) == (["normals_facing", "rejected"], ["normals_true", "kept"])
    record = json.loads(target.read_text())
    assert apart_line(record["apart"]).split() in printed
    assert list(record["effects"]) == list(EFFECTS) and len(record["photos"]) == 9
    verdicts = record["normals"]
    assert verdicts["normals_true"]["share"] > 0.9 and verdicts["normals_facing"]["share"] == 0
    assert all(photo["kept"] > 0.8 for photo in verdicts["normals_true"]["photos"].values())
    assert read_image(target.with_suffix(".png"))[0].std() > 10
    assert cli.main(["diagnose", str(root), "--json", str(tmp_path / "found.png")]) == 2
    assert "must end in .json" in capsys.readouterr().err
