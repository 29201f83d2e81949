import math

import pytest

from gsjax import config
from gsjax.errors import InputError
from gsjax.presets import PRESETS
from gsjax.settings import Density, Logging, Phase, Rates, Schedule, Settings, Weights
from gsjax.training.plan import plan
from gsjax.training.terms import Term

PHASES = (
    Phase("coarse", 500, image_scale=2, density_control=True),
    Phase("surface", 301, Weights(sdf_normal=0.2, multi_view=0.1), cull_below=0.5, surface_every=2, surface_scale=3),
)
SETTINGS = Settings(
    schedule=Schedule(phases=PHASES, sh_every=150),
    rates=Rates(decay_steps=3000, final_share=0.2),
    density=Density(start=50, stop=900, every=50, reset_every=0),
    logging=Logging(50, 0, 250),
)


def needles(gaussians, view, batch):
    return gaussians.log_scales.mean()


def terms(phase):
    return {each.name: each.weight for each in phase.terms}


def test_phases_follow_each_other_with_their_terms_and_what_these_need():
    coarse, surface = plan(SETTINGS).phases
    assert (coarse.begin, coarse.end, surface.begin, surface.end) == (0, 500, 500, 801)
    assert (coarse.scale, surface.scale, surface.cull_below) == (2, 1, 0.5)
    assert (surface.surface_every, surface.surface_scale) == (2, 3)
    assert coarse.rule is not None and surface.rule is None
    assert terms(coarse) == {"l1": 0.8, "dssim": 0.2, "alpha": 0.1}
    assert terms(surface) == {"l1": 0.8, "dssim": 0.2, "sdf_normal": 0.2, "multi_view": 0.1, "alpha": 0.1}
    assert (coarse.needs, surface.needs) == ({"matte"}, {"depth", "normals", "neighbor", "gaussians", "matte"})
    assert [each.name for each in surface.image_terms] == ["l1", "dssim", "alpha"]


def test_a_sky_adds_its_term_to_every_step_and_without_one_it_is_nowhere():
    without = plan(SETTINGS)
    assert not any("sky" in phase.needs or "sky" in terms(phase) for phase in without.phases)
    with_sky = plan(SETTINGS).with_effects(("background", "sky"))
    assert [terms(phase) for phase in with_sky.phases] == [terms(phase) | {"sky": 0.1} for phase in without.phases]
    assert all("sky" in {each.name for each in phase.image_terms} for phase in with_sky.phases)
    assert plan(SETTINGS).with_effects(("background",)).phases == without.phases
    with pytest.raises(InputError, match="schedule.phases.surface.weights.sky: the effect sky adds"):
        plan(SETTINGS.replace(schedule={"phases": (Phase("surface", 10, Weights(sky=0.2)),)}))
    with pytest.raises(InputError, match="surface.weights.normal_consistency: only a refinement has a mesh"):
        plan(SETTINGS.replace(schedule={"phases": (Phase("surface", 10, Weights(normal_consistency=0.2)),)}))


def test_plain_splatting_has_the_terms_of_the_image_for_as_many_steps():
    plain = plan(SETTINGS.replace(schedule={"vanilla": True}, model={"stereo_points": 100}))
    assert plain.stereo_points == 0
    assert [terms(phase) for phase in plain.phases] == 2 * [{"l1": 0.8, "dssim": 0.2, "alpha": 0.1}]
    numbers = [(p.steps, p.cull_below, p.surface_every, p.surface_scale) for p in plain.phases]
    assert numbers == [(500, 0.0, 1, 1), (301, 0.0, 1, 1)]


def test_everything_comes_after_as_many_photos_and_rates_grow_with_the_root():
    larger = plan(SETTINGS.replace(schedule={"views_per_step": 4}))
    assert [phase.steps for phase in larger.phases] == [125, 76]
    assert larger.steps == larger.record()["steps"] == 201
    assert (larger.sh_every, larger.rates.decay_steps) == (38, 750)
    assert larger.density == Density(start=13, stop=225, every=13, reset_every=0)
    assert larger.logging == Logging(13, 0, 63)
    assert larger.rates.final_share == 0.2
    for name in ("means", "sh_rest", "scales", "quats"):
        assert getattr(larger.rates, name) == pytest.approx(2 * getattr(SETTINGS.rates, name))


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_may_be_taken_in_larger_steps(preset):
    views = 64
    settings = config.parse(Settings, config.merge(PRESETS[preset], {"schedule": {"views_per_step": views}}))
    larger = plan(settings)
    assert settings.schedule.steps <= views * larger.steps < settings.schedule.steps + views * len(larger.phases)
    assert larger.rates.means == pytest.approx(math.sqrt(views) * settings.rates.means)


def test_masks_of_transients_delay_densification():
    assert plan(SETTINGS).with_effects(["exposure"]).density == SETTINGS.density
    assert plan(SETTINGS).with_effects(["transients"]).density.start > SETTINGS.density.start


def test_a_term_of_ones_own_stands_beside_the_others_or_in_the_place_of_one():
    phase = Phase("surface", 10, Weights(needles=0.3, l1=0.5))
    settings = SETTINGS.replace(schedule={"phases": (phase,)})
    (planned,) = plan(settings, {"needles": Term(needles, "gaussians")}).phases
    assert terms(planned) == {"l1": 0.5, "dssim": 0.2, "alpha": 0.1, "needles": 0.3}
    (planned,) = plan(settings, {"needles": Term(needles), "l1": Term(needles)}).phases
    assert next(each.term.loss for each in planned.terms if each.name == "l1") is needles


def test_words_and_rules_that_nothing_provides_are_refused():
    words = "depth, axes, normals, measured, neighbor, sky, matte, mesh, gaussians"
    with pytest.raises(ValueError, match=f"needs='depht' is none of {words}"):
        Term(needles, {"depht"})
    with pytest.raises(InputError, match=r"^density\.rule='mine' is none of adc, error$"):
        plan(SETTINGS.replace(density=Density(rule="mine")))
