"""Terms, effects and a rule of densification that a run is handed: recorded, and needed again to resume."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from trained_run import SETTINGS, train_until_killed

import gsjax
from gsjax import config, pipeline, runs
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.runs.checkpoints import load_arrays
from gsjax.training.terms import Term

PHASES = [
    {"name": "plain", "steps": 3, "image_scale": 2},
    {"name": "round", "steps": 5, "image_scale": 2, "weights": {"needles": 5.0, "near": 0.1}},
]
LOGGING = {"metrics_every": 5, "evaluate_every": 0, "checkpoint_every": 4}
ENDED = config.merge(SETTINGS, {"schedule": {"phases": PHASES}, "logging": LOGGING})


def needles(gaussians, view, batch):
    return jnp.mean(gaussians.log_scales.max(-1) - gaussians.log_scales.min(-1))


def near(gaussians, view, batch):
    return jnp.mean(view.depth)


TERMS = {"needles": needles, "near": near}


@pytest.fixture(scope="module")
def rounder(scene, tmp_path_factory):
    run = tmp_path_factory.mktemp("own") / "run"
    pipeline.train(scene, run, ENDED, terms=TERMS)
    return run


def test_the_plan_has_the_terms_of_ones_own(rounder):
    plain, last = json_files.read(rounder / "plan.json")["phases"]
    assert (plain["name"], plain["steps"], set(plain["terms"])) == ("plain", 3, {"l1", "dssim", "alpha"})
    assert (last["name"], last["steps"], last["terms"]["needles"]) == ("round", 5, 5.0)
    assert (plain["needs"], last["needs"]) == (["matte"], ["depth", "gaussians", "matte"])
    assert set(runs.read_metrics(rounder)[-1]["terms"]) == {"l1", "dssim", "needles", "near"}


def norm_at_zero(gaussians, view, batch):
    """Zero, with a gradient that is NaN."""
    return jnp.linalg.norm(view.colors - jax.lax.stop_gradient(view.colors), axis=-1).mean()


def test_a_gradient_that_is_not_finite_ends_a_run_that_goes_on_once_its_term_is_mended(rounder, scene, tmp_path):
    run = tmp_path / "run"
    with pytest.raises(InputError, match=r"^step 4, photo \S+: the gradient of the loss term 'needles' is not finite"):
        pipeline.train(scene, run, ENDED, terms={**TERMS, "needles": norm_at_zero})
    assert runs.latest_checkpoint(run)[0] == 3
    with np.load(runs.latest_checkpoint(run)[1]) as arrays:
        assert all(np.isfinite(array).all() for array in arrays.values() if array.dtype.kind == "f")
    assert not (run / "gaussians.ply").exists()
    pipeline.train(scene, run, ENDED, terms=TERMS, resume=True)
    assert (run / "gaussians.ply").read_bytes() == (rounder / "gaussians.ply").read_bytes()


@pytest.mark.parametrize(
    ("own", "line"),
    [
        ({"near": Term(near)}, "the loss term 'near' reads the rendered depth, `View.depth`, and does not declare it"),
        ({"near": 0.5}, "terms.near is 0.5, expected a function"),
        ({"near": None}, r"schedule\.phases\.round\.weights\.near: no such term of the loss"),
    ],
)
def test_a_term_of_a_later_phase_is_tried_before_any_photo_is_read(scene, tmp_path, monkeypatch, own, line):
    monkeypatch.setattr(sys.modules["gsjax.planning.preparation"], "preload", None)  # What reads a photo.
    with pytest.raises(InputError, match=f"^{line}"):
        handed_in = {name: term for name, term in {**TERMS, **own}.items() if term is not None}
        pipeline.train(scene, tmp_path / "run", ENDED, terms=handed_in)
    assert not (tmp_path / "run").exists()


DENSIFIED = config.merge(SETTINGS, {"schedule": {"phases": SETTINGS["schedule"]["phases"][:1]}})


def fixed_number(gaussians, statistics, density, *, step, budget):
    return jnp.int32(850)


def dimmed(number, colors, photo):
    return colors * jnp.exp(-number)


PIECES = {
    "densification": gsjax.DENSIFICATION_RULES["error"]._replace(wanted_count=fixed_number),
    "effects": {"dimmer": gsjax.Effect(np.float32(0), optax.constant_schedule(1e-2), light=dimmed)},
}


def test_pieces_that_are_handed_in_train_and_are_needed_again_to_resume_to_the_same_bits(scene, tmp_path):
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    assert pipeline.train(scene, whole, DENSIFIED, **PIECES)["gaussians"] == 850
    manifest = json_files.read(whole / "manifest.json")
    assert manifest["handed_in"] == {"terms": [], "effects": ["dimmer"], "densification": True}
    assert json_files.read(whole / "plan.json")["effects"] == ["dimmer"]
    stored = load_arrays(runs.latest_checkpoint(whole)[1])
    (learned,) = (value for name, value in stored.items() if name.endswith(".numbers['dimmer']"))
    assert abs(learned) > 0.01

    train_until_killed(9, scene, stopped, DENSIFIED, **PIECES)
    with pytest.raises(InputError, match=r"was started with effects=\{dimmer\}, densification=, not with no terms="):
        pipeline.train(scene, stopped, DENSIFIED, resume=True)
    pipeline.train(scene, stopped, DENSIFIED, resume=True, **PIECES)
    assert (stopped / "gaussians.ply").read_bytes() == (whole / "gaussians.ply").read_bytes()
    with pytest.raises(InputError, match="'poses' is an effect of the library; give yours another name"):
        pipeline.train(scene, tmp_path / "other", DENSIFIED, effects={"poses": PIECES["effects"]["dimmer"]})
