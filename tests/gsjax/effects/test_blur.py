"""Blurred photos of a painted wall: named, and left out of training where others see what they see."""

from dataclasses import replace

import numpy as np
import pytest
from photographed_wall import wall, with_tracks
from scipy import ndimage

from gsjax.effects.blur import photos_to_leave_out
from gsjax.effects.diagnosis import diagnose
from gsjax.effects.observations import edge_width, observe
from gsjax.planning.effects import inspect_photos
from gsjax.scene import with_pixels


def blurred(*indices):
    """The wall with fine grain in all photos, and some of them blurred."""
    scene, noise = wall(), np.random.default_rng(0).integers(-20, 20, (72, 96, 1))
    frames = []
    for index, frame in enumerate(scene.frames):
        image = np.clip(frame.pixels().image + noise, 0, 255).astype(np.float64)
        image = ndimage.gaussian_filter(image, (1, 1, 0)) if index in indices else image
        frames.append(with_pixels(frame, frame.pixels()._replace(image=image.astype(np.uint8))))
    return replace(scene, frames=tuple(frames))


def test_blurred_photos_are_named_and_left_out_where_others_see_what_they_see():
    for photos, names in (((4,), ("04.png",)), ((4, 7), ("04.png", "07.png")), ((), ())):
        scene = blurred(*photos)
        assert photos_to_leave_out(observe(scene)) == names
        blur = diagnose(scene).effects["blur"]
        assert blur.on == bool(photos)
        assert not photos or blur.note.startswith(f"blurred: {', '.join(names)}; {len(names)} by more than 70 %")
    frames = [replace(frame, held_out=frame.name == "07.png") for frame in blurred(4, 7).frames]
    scene = replace(scene, frames=tuple(frames))
    assert photos_to_leave_out(observe(scene)) == ("04.png",), "held-out photos are not trained on"


@pytest.mark.parametrize(("share", "expected"), [(0.05, ("04.png",)), (0.2, ())])
def test_a_photo_stays_where_nobody_else_sees_so_much_of_it(share, expected):
    tracks = wall().tracks()
    alone = with_tracks(blurred(4), (tracks.photo == 4) | (tracks.point % 100 >= 100 * share))
    assert photos_to_leave_out(observe(alone)) == expected


def test_blurred_photos_do_not_vouch_for_each_other_and_one_sharp_one_is_too_few():
    scene = blurred(4, 7)
    tracks = scene.tracks()
    shared = np.flatnonzero(np.bincount(tracks.point, minlength=400) == 12)  # seen by all photos
    for witnesses, expected in (((0,), ()), ((0, 1), ("04.png", "07.png"))):
        photos = (4, 7, *witnesses)
        partial_scene = with_tracks(scene, np.isin(tracks.photo, photos) & np.isin(tracks.point, shared))
        assert photos_to_leave_out(observe(partial_scene)) == expected


@pytest.mark.parametrize(("effects", "expected"), [("auto", ("04.png",)), ("poses,blur", ("04.png",)), ("poses", ())])
def test_who_asks_for_it_gets_a_scene_without_and_a_diagnosis_of_that_scene(effects, expected, capsys):
    scene = blurred(4)
    result = inspect_photos(effects, scene)
    assert result.left_out == expected
    names = tuple(frame.name for frame in scene.frames if frame.name not in expected)
    assert tuple(frame.name for frame in result.scene.frames) == names
    assert tuple(frame.name for frame in result.diagnosis.observations.frames) == names
    assert result.diagnosis.effects["blur"].note.startswith("blurred: 04.png"), "told of the whole scene"
    assert ("left out: 04.png\n" in capsys.readouterr().err) == bool(expected)


@pytest.mark.parametrize(("sigma", "width"), [(1.0, 2.5), (2.0, 5.0)])
def test_an_ideal_edge_under_a_blur_is_so_wide(sigma, width):
    """Its steepest slope is the contrast over sigma times the square root of two pi."""
    stripes = np.where(np.arange(240) // 24 % 2, 200.0, 50.0)[None].repeat(120, 0).astype(np.float32)
    usable = np.ones(stripes.shape, bool)
    assert edge_width(stripes, usable) == 1.0
    blurred = ndimage.gaussian_filter1d(stripes, sigma, axis=1)
    assert edge_width(blurred, usable) == pytest.approx(width, rel=0.06)
    assert edge_width(stripes, ~usable) == 0 and edge_width(np.zeros((40, 40), np.float32), usable[:40, :40]) == 0
