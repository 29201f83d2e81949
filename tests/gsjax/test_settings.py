import itertools
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gsjax.binding.refinement import Refinement
from gsjax.config import as_record, merge, parse, to_dict
from gsjax.errors import InputError
from gsjax.presets import LENGTHS, PRESETS, preset
from gsjax.settings import (
    EffectChoice,
    Model,
    Phase,
    Photos,
    Rates,
    Schedule,
    Settings,
    Supervision,
    Weights,
    named_effects,
)


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_a_valid_difference_that_survives_a_round_trip(name):
    settings = parse(Settings, PRESETS[name])
    assert Settings(**PRESETS[name]) == parse(Settings, to_dict(settings)) == settings
    assert settings.effects.names == ("auto" if name in LENGTHS else "none"), "the papers' have no effects"
    with_r = [phase.name for phase in settings.schedule.phases if {"sdf_normal", "pixel_normal"} & phase.weights.keys()]
    assert with_r == ([] if name == "quick" else ["surface"])  # `quick` has no time for a surface.


def test_each_of_the_lengths_is_longer_than_the_one_before_and_none_than_the_papers():
    lengths = [preset(name) for name in LENGTHS]
    assert lengths[-1].schedule.steps == 15_000
    for shorter, longer in itertools.pairwise(lengths):
        assert shorter.schedule.steps < longer.schedule.steps
        assert shorter.model.max_gaussians < longer.model.max_gaussians


@pytest.mark.parametrize(
    ("difference", "message"),
    [
        ({"model": {"sh_degree": 5}}, "model: sh_degree=5"),
        ({"schedule": {"dropout": 1.0}}, "dropout=1.0 is not at least 0 and below 1"),
        ({"model": {"max_gaussians": 10**12}}, "max_gaussians=1000000000000 is above 2147483647"),
        ({"schedule": {"phases": []}}, "there are no phases"),
        ({"seed": -1}, "seed=-1 is not between 0 and 4294967295"),
        ({"rates": {"scales": -1e-3}}, "rates: scales=-0.001 is below 0"),
        ({"density": {"full_by": 2}}, "density: full_by=2.0 is not between 0 and 1"),
        ({"schedule": {"phases": [{"name": "a", "steps": -1}]}}, r"phases.0: steps=-1 is below 0"),
        ({"rates": {"means": 0.0}}, r"rates: means=0.0 is below 1.6e-06"),
    ],
)
def test_a_value_out_of_range_is_one_line_that_says_where(difference, message):
    with pytest.raises(InputError, match=message) as caught:
        parse(Settings, merge(PRESETS["fast"], difference))
    assert "\n" not in str(caught.value)


def weight_of_normals(settings):
    return settings.schedule.phases[2].weights["pixel_normal"]


def test_normal_maps_weigh_more_than_the_normals_of_the_photos_themselves():
    for name in LENGTHS[1:]:
        with_maps = preset(name, {"supervision": {"normals": "maps"}})
        assert (weight_of_normals(preset(name)), weight_of_normals(with_maps)) == (0.1, 0.4)
    for name in PRESETS.keys() - set(LENGTHS[1:]):
        assert preset(name, {"supervision": {"normals": "maps"}}).schedule == preset(name).schedule


def test_effects_are_named_in_any_order_and_unknown_ones_are_refused():
    assert named_effects("none") == named_effects("auto") == ()
    assert named_effects("vignetting, exposure") == ("exposure", "vignetting")
    for choice in ("fog", "exposure,", "none,exposure"):
        with pytest.raises(ValueError, match="is none of auto, none, exposure, vignetting"):
            EffectChoice(choice)


def test_rates_that_no_file_told_are_held_to_the_same():
    with pytest.raises(ValueError, match="scales=inf is not a finite number"):
        Rates(scales=float("inf"))
    with pytest.raises(ValueError, match="seed=4294967296 is not between 0 and 4294967295"):
        Refinement(seed=2**32)


def test_what_a_program_has_at_hand_is_as_good_as_plain_data():
    """Numbers of numpy and jax, paths, lists and tables; and all of it is hashable, equal and can be written."""
    settings = Settings(
        seed=np.int64(3),
        photos={"downscale": np.float32(2)},
        supervision=Supervision(normals=Path("maps")),
        model={"max_gaussians": jnp.int32(900), "sh_degree": np.array(2)},
        schedule={
            "vanilla": np.bool_(False),
            "phases": [{"name": "a", "steps": np.int64(3), "weights": {"l1": np.float32(0.5), "mine": 1}}],
        },
    )
    plain = Settings(
        seed=3,
        photos=Photos(downscale=2.0),
        supervision=Supervision(normals="maps"),
        model=Model(max_gaussians=900, sh_degree=2),
        schedule=Schedule((Phase("a", 3, Weights(l1=0.5, mine=1.0)),)),
    )
    assert settings == plain and hash(settings) == hash(plain)
    assert json.loads(json.dumps(to_dict(settings))) == to_dict(plain)
    assert (type(settings.seed), type(settings.photos.downscale)) == (int, float)


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (lambda: Schedule(Phase("a", 3)), r"Schedule: phases is Phase\(.*, expected a list of a table of keys"),
        (lambda: Schedule([{"name": "a"}]), "Schedule: key 'phases.0.steps' is missing"),
        (lambda: Settings(rates={"meens": 1e-3}), "Settings: unknown key 'rates.meens'; the nearest known one is"),
        (lambda: Phase("a", 3, {"l1": "much"}), "Phase: weights.l1 is 'much', expected float"),
        (lambda: Weights(l1=float("nan")), "Weights: l1 is nan, expected a finite number"),
        (lambda: Refinement(pixel_filter="box"), "Refinement: pixel_filter is 'box', expected one of"),
        (lambda: jax.jit(lambda degree: Model(sh_degree=degree))(3), "Model: sh_degree is .*, expected int"),
    ],
)
def test_a_setting_of_another_type_is_one_line_that_names_it(make, line):
    with pytest.raises(InputError, match=line) as refused:
        make()
    assert str(refused.value).isprintable()


@pytest.mark.parametrize(
    ("flat", "now"),
    [
        ({"max_gaussians": 3}, "max_gaussians is model.max_gaussians now"),
        ({"effects": "auto"}, "effects is effects.names now"),
        ({"phases": {"surface": {"steps": 3}}}, "phases is schedule.phases now"),
    ],
)
def test_keys_without_a_group_are_refused_with_the_key_of_today(flat, now):
    for make in (lambda: Settings(**flat), lambda: preset("fast", flat), lambda: as_record(Settings, flat)):
        with pytest.raises(InputError, match=f": {now}$"):
            make()
