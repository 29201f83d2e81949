"""Trials near a threshold: who is tried, and what they find where an effect is there and where it is not."""

from dataclasses import replace
from functools import partial

import pytest
from photographed_wall import gains as drawn_gains
from photographed_wall import relit, wall
from small_scenes import built_in

from gsjax.effects.evidence import Cost, Evidence, unknown
from gsjax.effects.observations import observe
from gsjax.io.scenes import load_scene
from gsjax.planning.effect_trials import FEWEST_STEPS, NEAR, gains, is_near
from gsjax.planning.effects import choose_effects
from gsjax.planning.sizes import training_extent
from gsjax.planning.start import first_state
from gsjax.settings import Phase, Settings
from gsjax.training.plan import plan

SETTINGS = Settings(background="white", phases=(Phase("vanilla", 300),), sh_degree=1, effects="auto")
LONG = replace(SETTINGS, phases=(Phase("vanilla", FEWEST_STEPS),))


def evidence(value):
    return Evidence(False, value, "EV", 0.01, 0.05, Cost(), "")


def test_only_what_is_near_is_tried():
    assert is_near("exposure", evidence(0.05))
    assert is_near("exposure", evidence(0.99 * NEAR * 0.05))
    assert is_near("poses", evidence(1.01 * 0.05 / NEAR))
    assert not is_near("exposure", evidence(1.01 * NEAR * 0.05))
    assert not is_near("exposure", evidence(-0.05))
    assert not is_near("exposure", unknown("EV", 0.05, Cost(), "why"))
    assert not is_near("transients", evidence(0.05)), "masks choose what they are scored on"


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return load_scene(built_in(tmp_path_factory.mktemp("data") / "scene", num_views=8, size=(32, 32)))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["relit", "clean"])
def test_a_trial_finds_what_is_there_and_nothing_where_nothing_is(scene, kind):
    true = drawn_gains(scene, 0.3)
    photos = relit(scene, lambda index, *_: true[index]) if kind == "relit" else scene
    few = replace(photos, points=photos.points[::4], point_colors=photos.point_colors[::4])
    initial = partial(first_state, few, SETTINGS)
    found = gains(
        plan(SETTINGS), photos.train_frames, training_extent(photos), initial, observe(photos), (), ("exposure",)
    )["exposure"]
    assert found > 0.5 if kind == "relit" else abs(found) < 0.1


@pytest.mark.parametrize(("gain", "on"), [(0.09, False), (0.11, True)])
def test_a_trial_has_the_last_word_and_the_evidence_tells_of_it(gain, on):
    """A fifteenth of a stop: over the threshold, but near it."""
    scene = wall()
    true = drawn_gains(scene, 0.1)
    photos = relit(scene, lambda index, *_: true[index])
    asked = []

    def trial(seen, others, near):
        asked.append((list(others), list(near)))
        return dict.fromkeys(near, gain)

    found = choose_effects("auto", plan(LONG), photos, trial)
    assert asked == [([], ["exposure"])]
    assert ("exposure" in found.effects) == on
    told = found.evidence["evidence"]["exposure"]
    assert told["on"] == on
    assert told["note"].startswith(f"near its threshold, a trial of it brings +{gain} dB (needs 0.1); ")
    assert "exposure" in choose_effects("auto", plan(LONG), photos).effects
    strong = relit(scene, lambda index, *_: 5 * true[index])
    asked.clear()
    assert "exposure" in choose_effects("auto", plan(LONG), strong, trial).effects
    assert not asked
    # A step fewer, and the run is too short for a trial to tell.
    short = replace(SETTINGS, phases=(Phase("vanilla", FEWEST_STEPS - 1),))
    assert "exposure" in choose_effects("auto", plan(short), photos, trial).effects
    assert not asked
