"""Rooms with plain ceilings and walls have no sky; places under a sky that says where it is have one."""

from functools import cache

import pytest
from plain_places import DOUBTFUL, GLASS, ROOMS, SKIES
from plain_scenes import photograph

from gsjax.effects.diagnosis import diagnose
from gsjax.planning.effects import choose_effects
from gsjax.settings import Settings
from gsjax.training.plan import plan


@cache
def photographed(name):
    """The scene of a place, and which pixels show its sky."""
    return photograph((ROOMS | SKIES | DOUBTFUL | GLASS)[name], gains=0.1)


SHORT = {
    "bare walls over a dado, window",
    "a shaded studio",
    "a yard, blue",
    "a low glass front under clouds",
    "a yard, flat grey",
    "a high glass front",
}
"""One place of each kind; the others run with --long."""


def places(*groups):
    names = [name for group in groups for name in group]
    return pytest.mark.parametrize(
        "name", [name if name in SHORT else pytest.param(name, marks=pytest.mark.long) for name in names]
    )


@places(ROOMS)
def test_a_plain_ceiling_or_wall_is_no_sky_and_no_backdrop(name):
    diagnosis = diagnose(photographed(name)[0])
    assert not diagnosis.effects["sky"].on and not diagnosis.effects["background"].on
    assert not diagnosis.sky


@places(SKIES)
def test_a_sky_whose_light_depends_on_the_direction_is_found(name):
    scene, truth = photographed(name)
    diagnosis = diagnose(scene)
    assert diagnosis.effects["sky"].on == (name != "a yard, glow of a town at night"), "too dark to compare: a miss"
    for frame, is_sky in zip(scene.frames, truth, strict=True):
        if frame.name in diagnosis.sky:
            assert (diagnosis.sky[frame.name] & ~is_sky).sum() < 0.01 * is_sky.size


@places(DOUBTFUL, GLASS)
def test_where_nothing_tells_a_sky_from_plaster_no_surface_is_taken_away(name):
    diagnosis = diagnose(photographed(name)[0])
    assert not diagnosis.effects["sky"].on and not diagnosis.sky


def test_who_names_the_sky_gets_what_looks_like_one_though_evidence_is_missing():
    scene, truth = photographed("a yard, flat grey")
    named = choose_effects("none", plan(Settings()), scene, with_sky=True).skies
    for frame, is_sky in zip(scene.frames, truth, strict=True):
        assert (named[frame.name] & is_sky).sum() > 0.8 * is_sky.sum()
