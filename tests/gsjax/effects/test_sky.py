"""A box on a lawn under clouds, seen from a circle, against the pixels that show that sky."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest
from plain_places import cloudy, flat_white
from plain_scenes import Box, Place, photograph, textured
from tolerances import assert_close

from gsjax.effects import background, sky
from gsjax.effects.diagnosis import diagnose
from gsjax.effects.observations import observe
from gsjax.errors import InputError
from gsjax.io.images import read_mask, write_image
from gsjax.io.scenes import load_scene
from gsjax.planning.effects import choose_effects
from gsjax.planning.sky_masks import read_sky_masks
from gsjax.planning.start import first_state
from gsjax.rendering import backdrop
from gsjax.runs.records import read_views
from gsjax.runs.result import frame_camera, write_views
from gsjax.scene import with_pixels
from gsjax.scene.batches import decode, read_batches, with_skies
from gsjax.settings import EffectChoice, Model, Rates, Settings
from gsjax.training.densification.gradient_driven import is_alive
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.optimizers import make_optimizer
from gsjax.training.plan import plan

ANGLES = np.linspace(0, 2, 7)
MIDDLE = (0.0, 0.0, 1.8)


def yard(*, sky=cloudy, lawn=60.0, angles=ANGLES, target=MIDDLE, also=()):
    """The scene, and where its photos show sky by name; `also`: targets of more photos from the first place."""
    eyes = np.stack([7 * np.cos(angles), 7 * np.sin(angles), np.full(len(angles), 1.6)], 1)
    ground = Box((-lawn, -lawn, -1), (lawn, lawn, 0), textured())
    box = Box((-2, -2, 0), (2, 2, 2.5), textured())
    eyes, targets = np.concatenate([eyes, *[eyes[:1] for _ in also]]), [target] * len(angles) + list(also)
    scene, truth = photograph(Place((ground, box), eyes, np.array(targets), sky))
    return scene, {frame.name: is_sky for frame, is_sky in zip(scene.frames, truth, strict=True)}


def agreement(mask, truth):
    return (mask & truth).sum() / (mask | truth).sum()


@pytest.fixture(scope="module")
def sky_scene():
    scene, truth = yard()
    return scene, truth, sky.find(observe(scene))


def test_the_sky_is_found_to_its_outline_and_nothing_else(sky_scene):
    scene, truth, masks = sky_scene
    assert masks.keys() == truth.keys()
    for name, mask in masks.items():
        assert agreement(mask, truth[name]) > 0.9
        assert not (mask & ~truth[name]).any()
    evidence = diagnose(scene).effects["sky"]
    share = np.mean([mask.mean() for mask in masks.values()])
    assert evidence.on and evidence.note.split(";")[0] == f"sky in 7 of 7 photos, {100 * share:.0f} % of their pixels"


def test_a_backdrop_that_goes_on_below_the_horizon_is_no_sky_and_one_that_is_asked_for_is_one_line():
    scene, truth = yard(lawn=3.0, sky=flat_white)
    assert all(mask.mean() > 0.2 for mask in truth.values())
    with pytest.raises(InputError, match="show no sky; effects.sky takes a folder of masks"):
        choose_effects("none", plan(Settings()), scene, with_sky=True)


def test_an_even_wall_before_which_points_were_matched_is_no_sky(sky_scene):
    scene, truth, _ = sky_scene
    beside = np.random.default_rng(1).normal(size=(3000, 3)) * np.array([3, 3, 1.5]) + np.array([0, 0, 7])
    behind = replace(scene, points=np.concatenate([scene.points, beside.astype(np.float32)]))
    assert not sky.find(observe(behind))


def test_a_photo_of_nothing_but_sky_is_all_sky_where_others_tell():
    scene, truth = yard(also=[(-3, 0, 9)])
    assert truth["07.png"].all()
    assert sky.find(observe(scene))["07.png"].mean() > 0.8


def test_one_photo_no_points_and_mattes_tell_of_none(sky_scene):
    scene, _, _ = sky_scene
    assert not sky.find(observe(replace(scene, frames=scene.frames[:1])))
    assert not sky.find(observe(replace(scene, points=scene.points[:0], tracks=None)))
    matte = np.full((90, 120), 255, np.uint8)
    cut_out = tuple(with_pixels(frame, frame.pixels()._replace(matte=matte)) for frame in scene.frames)
    observations = observe(replace(scene, frames=cut_out))
    assert not sky.find(observations) and not sky.judge_masks(observations, {}).on


def test_what_is_masked_is_no_sky(sky_scene):
    scene, truth, masks = sky_scene
    left = np.full((90, 120), 255, np.uint8)
    left[:, :40] = 0
    masked = tuple(with_pixels(frame, frame.pixels()._replace(valid=left)) for frame in scene.frames)
    for name, mask in sky.find(observe(replace(scene, frames=masked))).items():
        assert not mask[left == 0].any()
        assert agreement(mask, truth[name] & (left > 0)) > 0.85


def test_up_is_found_by_cameras_that_look_up_one_way():
    scene, _ = yard(angles=np.linspace(0, 0.5, 4), target=(0.0, 0.0, 4.8))
    up = sky.upwards(scene.frames)
    assert_close(up, np.array([0.0, 0.0, 1.0]), atol=0.04, rtol=0, why="two degrees; their own mean is 25 off")


def test_only_what_hangs_in_the_air_lies_in_the_sky(sky_scene):
    scene, _, masks = sky_scene
    rng = np.random.default_rng(2)
    above = np.concatenate([rng.uniform(-2, 2, (50, 2)), rng.uniform(3.5, 4, (50, 1))], 1)
    assert sky.lies_in(above, scene.frames, masks).all()
    assert not sky.lies_in(scene.points, scene.frames, masks).any()
    elsewhere = np.array([[np.nan, 0, 4], [0, 0, -500.0], [1e9, 1e9, -1e9]])
    assert not sky.lies_in(elsewhere, scene.frames, masks).any()
    assert not sky.lies_in(above, scene.frames, {}).any()
    one_wrong = {"00.png": np.ones((90, 120), bool)}
    assert not sky.lies_in(scene.points, scene.frames, one_wrong).any()


def test_the_background_begins_with_the_colours_of_the_sky(sky_scene):
    scene, truth, masks = sky_scene
    coefficients = background.initial(observe(scene), masks)
    sky_colors = np.asarray(jax.jit(backdrop.color_behind)(coefficients, frame_camera(scene.frames[0])))
    image = scene.frames[0].pixels().image / 255
    assert np.abs(sky_colors - image)[truth["00.png"]].mean() < 0.03  # its clouds are no harmonics


def test_a_smaller_pixel_is_sky_where_all_of_it_is(sky_scene):
    scene, _, _ = sky_scene
    mask = np.zeros((90, 120), bool)
    mask[:7, :5] = True
    views = with_skies(read_batches(scene.frames[:2], scale=2), [mask, None], 2)
    expected = np.zeros((45, 60), bool)
    expected[:3, :2] = True
    sky_mask, bare = (target.sky for target in views.views)
    np.testing.assert_array_equal(sky_mask, expected)
    assert bare is not None and not bare.any()
    assert decode(read_batches(scene.frames[:1]).views[0], np.zeros(3, np.float32)).sky is None


@pytest.fixture
def on_disk(tmp_path, sky_scene):
    """Two photos with a `transforms.json`, and `sky/` with a mask half as large of one of them."""
    frames = []
    for frame in sky_scene[0].frames[:2]:
        write_image(tmp_path / frame.name, frame.pixels().image)
        to_world = np.linalg.inv(frame.viewmat) @ np.diag([1.0, -1, -1, 1])
        frames.append({"file_path": frame.name, "transform_matrix": to_world.tolist()})
    record = {"w": 120, "h": 90, "fl_x": 95.0, "fl_y": 95.0, "cx": 60, "cy": 45, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(record))
    half = np.full((45, 60), 255, np.uint8)
    half[:10] = 0
    write_image(tmp_path / "sky/00.png", half)
    return tmp_path


def test_masks_that_are_given_are_read_at_the_photos_size(on_disk):
    scene = load_scene(on_disk)
    masks = read_sky_masks(scene, "sky", None, 1.0)
    assert list(masks) == ["00.png"]
    np.testing.assert_array_equal(masks["00.png"], np.arange(90)[:, None].repeat(120, 1) < 20)
    assert read_sky_masks(scene, None, None, 1.0) is None
    assert read_sky_masks(scene, "auto", None, 1.0) is None


@pytest.mark.parametrize(
    ("folder", "shape", "fault"),
    [
        ("nowhere", None, "there is no such folder"),
        ("sky", (45, 50), "mask is 50x45"),
        ("sky", (90, 120), "is 0 anywhere"),
    ],
)
def test_masks_that_do_not_serve_are_refused(on_disk, folder, shape, fault):
    if shape is not None:
        write_image(on_disk / "sky/00.png", np.full(shape, 255, np.uint8))
    with pytest.raises(InputError, match=fault):
        read_sky_masks(load_scene(on_disk), folder, None, 1.0)


def test_a_run_takes_in_what_it_finds_or_is_given_and_starts_below_it(sky_scene):
    scene, truth, masks = sky_scene
    settings = Settings(effects=EffectChoice(names="auto"), model=Model(far_points=200, max_gaussians=4000))
    choice = choose_effects("auto", plan(settings), scene, lambda *_: pytest.fail("nothing is in doubt"))
    assert choice.names == ("background", "sky") and choice.skies.keys() == masks.keys()
    assert choice.evidence["simulated"] == ["background", "sky"]
    assert choice.evidence["evidence"]["sky"]["note"].startswith("simulated: certain without validation; ")
    optimizer = make_optimizer(Rates(), 1.0, 100)
    state = first_state(
        scene, settings.model, DENSIFICATION_RULES["adc"], optimizer, choice.effects, skies=choice.skies
    )
    means = np.asarray(state.gaussians.means)[np.asarray(is_alive(state.gaussians))]
    assert len(scene.points) < len(means) < len(scene.points) + 200
    assert not sky.lies_in(means, scene.frames, masks).any()
    mask_choice = choose_effects("none", plan(settings), scene, skies={"03.png": truth["03.png"]})
    assert mask_choice.names == ("background", "sky") and list(mask_choice.skies) == ["03.png"]


def test_no_surface_is_looked_for_in_the_sky_of_a_run(sky_scene, tmp_path):
    scene, _, masks = sky_scene
    held_out = replace(scene.frames[0], held_out=True)
    write_views(tmp_path / "run", (held_out, *scene.frames[1:]), masks)
    records = read_views(tmp_path / "run")
    assert records[0]["mask"] is None
    for record in records[1:]:
        np.testing.assert_array_equal(read_mask(tmp_path / "run" / record["mask"]) == 0, masks[record["name"]])
