import math
from dataclasses import replace

import pytest

from gsjax import config
from gsjax.settings import PRESETS, Density, Logging, Phase, Rates, Settings, total_steps
from gsjax.training.batches import in_larger_steps

SETTINGS = Settings(
    phases=(Phase("coarse", 500, image_scale=2, density_control=True), Phase("surface", 301)),
    rates=Rates(decay_steps=3000, final_share=0.2),
    density=Density(start=50, stop=900, every=50, reset_every=0, prune_large_after=200),
    logging=Logging(50, 0, 250),
    sh_every=150,
)


def test_a_view_a_step_changes_nothing():
    assert in_larger_steps(SETTINGS) is SETTINGS


def test_everything_comes_after_as_many_photos_and_rates_grow_with_the_root():
    larger = in_larger_steps(replace(SETTINGS, views_per_step=4))
    assert [phase.steps for phase in larger.phases] == [125, 76]
    assert (larger.sh_every, larger.rates.decay_steps) == (38, 750)
    assert larger.density == Density(start=13, stop=225, every=13, reset_every=0, prune_large_after=50)
    assert larger.logging == Logging(13, 0, 63)
    assert larger.rates.final_share == 0.2
    for name in ("means", "means_final", "sh_dc", "sh_rest", "opacities", "scales", "quats"):
        assert getattr(larger.rates, name) == pytest.approx(2 * getattr(SETTINGS.rates, name))


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("views", [2, 3, 64])
def test_every_preset_may_be_taken_in_larger_steps(preset, views):
    settings = config.parse(Settings, {**PRESETS[preset], "views_per_step": views})
    larger = in_larger_steps(settings)
    assert total_steps(settings) <= views * total_steps(larger) < total_steps(settings) + views * len(larger.phases)
    assert larger.rates.means == pytest.approx(math.sqrt(views) * settings.rates.means)
