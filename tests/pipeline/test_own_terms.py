"""Terms of the loss that a run is handed: in its plan, edited, and after a resume."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trained_run import SETTINGS, train_until_killed

from gsjax import config, pipeline, runs
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.ply import read_gaussians
from gsjax.settings import Settings
from gsjax.training.terms import Term

ENDED = config.parse(
    Settings,
    config.merge(
        SETTINGS,
        {
            "schedule": {
                "phases": [
                    {"name": "plain", "steps": 3, "image_scale": 2},
                    {"name": "round", "steps": 5, "image_scale": 2, "weights": {"needles": 5.0, "near": 0.1}},
                ]
            },
            "logging": {"metrics_every": 5, "evaluate_every": 0, "checkpoint_every": 4},
        },
    ),
)


def needles(gaussians, view, batch):
    return jnp.mean(gaussians.log_scales.max(-1) - gaussians.log_scales.min(-1))


def rods(gaussians, view, batch):
    return -needles(gaussians, view, batch)


def near(gaussians, view, batch):
    return jnp.mean(view.depth)


def terms(own=needles):
    return {"needles": Term(own), "near": Term(near, needs={"depth"})}


def lengths(run):
    scales = read_gaussians(run / "gaussians.ply").log_scales
    return float(jnp.mean(scales.max(-1) - scales.min(-1)))


@pytest.fixture(scope="module")
def rounder(scene, tmp_path_factory):
    run = tmp_path_factory.mktemp("own") / "run"
    pipeline.train(scene, run, ENDED, terms=terms())
    return run


def test_the_plan_has_the_terms_of_ones_own(rounder):
    plain, last = json_files.read(rounder / "plan.json")["phases"]
    assert (plain["name"], plain["steps"], set(plain["terms"])) == ("plain", 3, {"l1", "dssim", "alpha"})
    assert (last["name"], last["steps"], last["terms"]["needles"]) == ("round", 5, 5.0)
    assert (plain["needs"], last["needs"]) == (["matte"], ["depth", "matte"])
    assert set(runs.read_metrics(rounder)[-1]["terms"]) == {"l1", "dssim", "needles", "near"}


def test_a_term_that_was_edited_is_the_one_that_runs(rounder, scene, tmp_path):
    pipeline.train(scene, tmp_path / "run", ENDED, terms=terms(rods))
    assert lengths(tmp_path / "run") > lengths(rounder) + 0.01


def test_a_run_with_terms_of_its_own_goes_on_to_the_same_bits(rounder, scene, tmp_path):
    train_until_killed(6, scene, tmp_path / "run", ENDED, terms=terms())
    pipeline.train(scene, tmp_path / "run", ENDED, terms=terms(), resume=True)
    assert (tmp_path / "run/gaussians.ply").read_bytes() == (rounder / "gaussians.ply").read_bytes()


def test_a_weight_without_its_term_is_one_line_before_anything_is_written(scene, tmp_path):
    with pytest.raises(InputError, match=r"^schedule\.phases\.round\.weights\.needles: no such term of the loss"):
        pipeline.train(scene, tmp_path / "run", ENDED)
    assert not (tmp_path / "run").exists()


def norm_at_zero(gaussians, view, batch):
    """Zero, with a gradient that is NaN."""
    return jnp.linalg.norm(view.colors - jax.lax.stop_gradient(view.colors), axis=-1).mean()


def test_a_gradient_that_is_not_finite_ends_a_run_that_goes_on_once_its_term_is_mended(rounder, scene, tmp_path):
    run = tmp_path / "run"
    with pytest.raises(InputError, match=r"^step 4, photo \S+: the gradient of the loss term 'needles' is not finite"):
        pipeline.train(scene, run, ENDED, terms=terms(norm_at_zero))
    assert runs.latest_checkpoint(run)[0] == 3
    with np.load(runs.latest_checkpoint(run)[1]) as arrays:
        assert all(np.isfinite(array).all() for array in arrays.values() if array.dtype.kind == "f")
    assert not (run / "gaussians.ply").exists()
    pipeline.train(scene, run, ENDED, terms=terms(), resume=True)
    assert (run / "gaussians.ply").read_bytes() == (rounder / "gaussians.ply").read_bytes()


def test_bare_functions_are_terms_that_need_what_they_read(rounder, scene, tmp_path):
    pipeline.train(scene, tmp_path / "run", ENDED, terms={"needles": needles, "near": near})
    assert (tmp_path / "run/gaussians.ply").read_bytes() == (rounder / "gaussians.ply").read_bytes()
    _, last = json_files.read(tmp_path / "run/plan.json")["phases"]
    assert last["needs"] == ["depth", "gaussians", "matte"]


@pytest.mark.parametrize(
    ("own", "line"),
    [
        ({"near": Term(near)}, "the loss term 'near' reads the rendered depth, `View.depth`, and does not declare it"),
        ({"near": lambda g, v, b: v.alphas}, r"the loss term 'near' returns an array of shape \(20, 24\)"),
        ({"near": lambda g, v, b: v.colours}, "the loss term 'near' cannot be computed: AttributeError"),
        ({"near": 0.5}, "terms.near is 0.5, expected a function"),
    ],
)
def test_a_term_of_a_later_phase_is_tried_before_any_photo_is_read(scene, tmp_path, monkeypatch, own, line):
    monkeypatch.setattr(sys.modules["gsjax.planning.preparation"], "preload", None)  # What reads a photo.
    with pytest.raises(InputError, match=f"^{line}"):
        pipeline.train(scene, tmp_path / "run", ENDED, terms={**terms(), **own})
    assert not (tmp_path / "run").exists()


def test_steps_of_several_views_are_all_of_the_run(scene, tmp_path):
    settings = config.parse(
        Settings,
        config.merge(
            SETTINGS, {"schedule": {"phases": [{"name": "plain", "steps": 8, "image_scale": 2}], "views_per_step": 4}}
        ),
    )
    pipeline.train(scene, tmp_path / "run", settings)
    assert json_files.read(tmp_path / "run/plan.json")["steps"] == 2
    runs.update_manifest(tmp_path / "run", status="stopped")
    pipeline.report(tmp_path / "run")
    assert "not finished: 2 of 2 steps logged" in (tmp_path / "run/report.html").read_text()
