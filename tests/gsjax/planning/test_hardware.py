"""What a run may be spread over, on this one device."""

from dataclasses import replace

import pytest

from gsjax.config import parse
from gsjax.errors import InputError
from gsjax.planning.hardware import count_devices, effects_asked, hardware
from gsjax.settings import PRESETS, Rates, Settings
from gsjax.training.loop import one_device
from gsjax.training.optimizers import make_optimizer

OPTIMIZER = make_optimizer(Rates(), 1.0, 10)


def test_one_device_with_a_view_a_step_is_the_program_that_knows_of_no_others():
    assert hardware("all", 1, OPTIMIZER).placement == one_device()


def test_more_devices_than_there_are_is_one_line_that_helps():
    with pytest.raises(InputError, match="--devices 3: there are 1; on a CPU, XLA_FLAGS=.*count=3 makes so many"):
        count_devices(3)


def test_nobody_looks_for_effects_where_a_step_has_several_views_and_one_line_says_so(capsys):
    """Presets look for them, and run on any number of devices; who names effects is told that it cannot be."""
    fast = parse(Settings, PRESETS["fast"])
    assert fast.effects == "auto"
    assert effects_asked(fast, 1) == "auto"
    named = replace(fast, effects="exposure", views_per_step=2)
    assert effects_asked(named, 1) == "exposure"
    assert not capsys.readouterr().err
    assert effects_asked(replace(fast, views_per_step=2), 1) == "none"
    assert capsys.readouterr().err == "train: effects need one device and one photo a step: nobody looks for any\n"
