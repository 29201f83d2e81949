import dataclasses
import itertools

import pytest

from gsjax.binding.refining import Refinement
from gsjax.config import merge, parse, to_dict
from gsjax.errors import InputError
from gsjax.settings import LENGTHS, PRESETS, Rates, Settings, named_effects, total_steps


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_a_valid_difference_that_survives_a_round_trip(name):
    settings = parse(Settings, PRESETS[name])
    assert parse(Settings, to_dict(settings)) == settings
    r = {"sdf_normal", "pixel_normal"} & settings.phases[-1].weights.keys()
    assert bool(r) == (name != "quick")  # which has no time for a surface


def test_each_of_the_lengths_is_longer_than_the_one_before_and_none_than_the_papers():
    lengths = [parse(Settings, PRESETS[name]) for name in LENGTHS]
    assert total_steps(lengths[-1]) == 15_000
    for shorter, longer in itertools.pairwise(lengths):
        assert total_steps(shorter) < total_steps(longer)
        assert shorter.max_gaussians < longer.max_gaussians


def test_presets_of_ours_look_for_effects_and_the_papers_have_none():
    looking = {name for name in PRESETS if parse(Settings, PRESETS[name]).effects == "auto"}
    assert looking == set(LENGTHS)
    assert {parse(Settings, PRESETS[name]).effects for name in PRESETS.keys() - looking} == {"none"}


@pytest.mark.parametrize(
    ("difference", "message"),
    [
        ({"sh_degree": 5}, "sh_degree=5"),
        ({"sh_every": 0}, "sh_every=0 is below 1"),
        ({"dropout": 1.0}, "dropout=1.0 is not at least 0 and below 1"),
        ({"downscale": 0}, "downscale=0.0 is not a number of at least 1"),
        ({"max_gaussians": 0}, "max_gaussians=0 is below 1"),
        ({"max_gaussians": 10**12}, "max_gaussians=1000000000000 is above 2147483647"),
        ({"phases": [{"name": "a", "steps": 10**10}]}, "steps=10000000000 is above 2147483647"),
        ({"phases": []}, "there are no phases"),
        ({"seed": -1}, "seed=-1 is not between 0 and 4294967295"),
        ({"seed": 2**32}, "seed=4294967296 is not between 0 and 4294967295"),
        ({"rates": {"scales": float("inf")}}, "rates.scales is inf, expected a finite number"),
        ({"rates": {"scales": -1e-3}}, "rates: scales=-0.001 is below 0"),
        ({"rates": {"decay_steps": 0}}, "rates: decay_steps=0 is below 1"),
        ({"density": {"gradient": -1}}, "density: gradient=-1.0 is below 0"),
        ({"density": {"min_opacity": 2}}, "density: min_opacity=2.0 is not between 0 and 1"),
        ({"phases": [{"name": "a", "steps": 1, "cull_below": 2}]}, "cull_below=2.0 is not between 0 and 1"),
        ({"phases": [{"name": "a", "steps": -1}]}, r"phases.0: steps=-1 is below 0"),
        ({"phases": [{"name": "a", "steps": 1, "image_scale": 0}]}, "image_scale=0 is below 1"),
        (
            {"phases": [{"name": "a", "steps": 1, "weights": {"l1": float("inf")}}]},
            "weights.l1 is inf, expected a finite number",
        ),
        ({"rates": {"means": 0.0}}, r"rates: means_final=1.6e-06 is not between 0 and means=0.0"),
        ({"rates": {"final_share": 0.0}}, "final_share=0.0 is not above 0 and at most 1"),
        ({"rates": {"means_final": 0.0}}, "means_final=0.0 is not between 0"),
        ({"density": {"every": 0}}, "density: every=0 is below 1"),
        ({"density": {"reset_every": -1}}, "reset_every=-1 is below 0"),
        ({"density": {"reset_opacity": 1.0}}, "reset_opacity=1.0 is not between 0 and 1"),
        ({"logging": {"metrics_every": 0}}, "logging: metrics_every=0 is below 1"),
        ({"logging": {"checkpoint_every": 0}}, "checkpoint_every=0 is below 1"),
        ({"background": "blue"}, "background is 'blue', expected one of \"white\""),
        ({"density": {"everry": 3}}, "unknown key 'density.everry'; the nearest known one is 'density.every'"),
    ],
)
def test_a_value_out_of_range_is_one_line_that_says_where(difference, message):
    with pytest.raises(InputError, match=message) as caught:
        parse(Settings, merge(PRESETS["fast"], difference))
    assert "\n" not in str(caught.value)


def test_settings_are_hashable_and_frozen():
    assert len({parse(Settings, PRESETS["accurate"]), parse(Settings, dict(PRESETS["accurate"]))}) == 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        Settings().seed = 1


@pytest.mark.parametrize(
    ("given", "names"),
    [("none", ()), ("auto", ()), ("vignetting, exposure", ("exposure", "vignetting")), ("exposure", ("exposure",))],
)
def test_effects_are_named_in_any_order(given, names):
    assert named_effects(given) == names
    assert Settings(effects=given).effects == given


@pytest.mark.parametrize("given", ["fog", "exposure,", "Auto", "none,exposure"])
def test_unknown_effects_are_refused(given):
    with pytest.raises(ValueError, match="is none of auto, none, exposure, vignetting"):
        Settings(effects=given)


def test_rates_that_no_file_told_are_held_to_the_same():
    with pytest.raises(ValueError, match="opacities=inf is not a finite number"):
        Rates(opacities=float("inf"))
    for seed in (-1, 2**32):
        with pytest.raises(ValueError, match=f"seed={seed} is not between 0 and 4294967295"):
            Refinement(seed=seed)
