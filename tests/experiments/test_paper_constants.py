"""The numbers of `paper_constants.py`, of the paper, 3DGS and SuGaR, are those that this project has."""

import pytest
from paper_constants import CONSTANTS, preset

from gsjax.presets import PRESETS


@pytest.mark.parametrize("constant", CONSTANTS, ids=lambda constant: constant.name)
def test_a_number_is_that_of_its_source(scripts, constant):
    scripts("paper_run")  # `read` may import scripts of the experiments
    assert constant.read() == constant.value, constant.source


@pytest.mark.parametrize("name", PRESETS)
def test_a_term_that_a_preset_names_has_a_weight_that_counts(name):
    for phase in preset(name).schedule.phases:
        assert all(weight >= 0.01 for weight in phase.weights.values() if weight), phase
