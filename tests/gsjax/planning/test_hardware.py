"""What a run may be spread over, on this one device."""

from dataclasses import replace

import pytest

from gsjax.config import parse
from gsjax.errors import InputError
from gsjax.planning.hardware import count_devices, hardware, without_looking, without_neighbors
from gsjax.settings import PRESETS, Phase, Rates, Settings, Weights
from gsjax.training.loop import one_device
from gsjax.training.optimizers import make_optimizer
from gsjax.training.step import active_terms

OPTIMIZER = make_optimizer(Rates(), 1.0, 10)
SETTINGS = Settings(phases=(Phase("vanilla", 10), Phase("surface", 10, Weights(multi_view=0.1))))


def test_one_device_with_a_view_a_step_is_the_program_that_knows_of_no_others():
    assert hardware("all", SETTINGS, OPTIMIZER).placement == one_device()


def test_more_devices_than_there_are_is_one_line_that_helps():
    with pytest.raises(InputError, match="--devices 3: there are 1; on a CPU, XLA_FLAGS=.*count=3 makes so many"):
        count_devices(3)


def test_terms_of_a_second_view_are_left_out_where_a_step_has_several_and_one_line_says_so(capsys):
    """Presets have them, and run on any number of devices."""
    fast = parse(Settings, PRESETS["fast"])
    assert without_neighbors(fast) is fast
    assert without_neighbors(replace(fast, views_per_step=4, vanilla=True)).phases == fast.phases
    assert not capsys.readouterr().err
    alone = without_neighbors(replace(fast, views_per_step=4))
    left = [{"l1", "dssim", "alpha"}, {"l1", "dssim", "alpha"}, {"l1", "dssim", "alpha", "sdf_normal", "pixel_normal"}]
    assert [set(active_terms(phase.weights)) for phase in alone.phases] == left
    assert capsys.readouterr().err == "train: multi_view, photometric need one photo a step and are left out\n"
    hardware(1, alone, OPTIMIZER)


def test_a_term_that_looks_further_than_one_view_is_refused_by_name():
    with pytest.raises(InputError, match="phase surface: multi_view needs one device"):
        hardware(1, replace(SETTINGS, views_per_step=2), OPTIMIZER)
    hardware(1, replace(SETTINGS, views_per_step=2, vanilla=True), OPTIMIZER)


def test_nobody_looks_for_effects_where_a_step_has_several_views_and_one_line_says_so(capsys):
    """Presets look for them, and run on any number of devices; who names effects is told that it cannot be."""
    fast = parse(Settings, PRESETS["fast"])
    assert fast.effects == "auto"
    assert without_looking(fast, 1) is fast
    named = replace(fast, effects="exposure", views_per_step=2)
    assert without_looking(named, 1) is named
    assert not capsys.readouterr().err
    assert without_looking(replace(fast, views_per_step=2), 1) == replace(fast, views_per_step=2, effects="none")
    assert capsys.readouterr().err == "train: effects need one device and one photo a step: nobody looks for any\n"
