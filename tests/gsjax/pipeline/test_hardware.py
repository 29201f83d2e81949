"""What a run may be spread over, on this one device."""

from dataclasses import replace

import pytest

from gsjax.errors import InputError
from gsjax.pipeline.hardware import count_devices, hardware
from gsjax.settings import Phase, Rates, Settings, Weights
from gsjax.training.loop import one_device
from gsjax.training.optimizers import make_optimizer

OPTIMIZER = make_optimizer(Rates(), 1.0, 10)
SETTINGS = Settings(phases=(Phase("vanilla", 10), Phase("surface", 10, Weights(multi_view=0.1))))


def test_one_device_with_a_view_a_step_is_the_program_that_knows_of_no_others():
    assert hardware("all", SETTINGS, OPTIMIZER).placement == one_device()


def test_more_devices_than_there_are_is_one_line_that_helps():
    with pytest.raises(InputError, match="--devices 3: there are 1; on a CPU, XLA_FLAGS=.*count=3 makes so many"):
        count_devices(3)


def test_a_term_that_looks_further_than_one_view_is_refused_by_name():
    with pytest.raises(InputError, match="phase surface: multi_view needs one device"):
        hardware(1, replace(SETTINGS, views_per_step=2), OPTIMIZER)
    hardware(1, replace(SETTINGS, views_per_step=2, vanilla=True), OPTIMIZER)
