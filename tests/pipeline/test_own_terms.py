"""Terms of the loss that a run is handed: in its plan, edited, and after a resume."""

import jax.numpy as jnp
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
    {
        **SETTINGS,
        "phases": [
            {"name": "plain", "steps": 3, "image_scale": 2},
            {"name": "round", "steps": 5, "image_scale": 2, "weights": {"needles": 5.0, "near": 0.1}},
        ],
        "logging": {"metrics_every": 5, "evaluate_every": 0, "checkpoint_every": 4},
    },
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
    assert (last["name"], last["steps"], last["terms"]["needles"], last["needs"]) == ("round", 5, 5.0, ["depth"])
    assert set(runs.read_metrics(rounder)[-1]["terms"]) == {"l1", "dssim", "needles", "near"}


def test_a_term_that_was_edited_is_the_one_that_runs(rounder, scene, tmp_path):
    pipeline.train(scene, tmp_path / "run", ENDED, terms=terms(rods))
    assert lengths(tmp_path / "run") > lengths(rounder) + 0.01


def test_a_run_with_terms_of_its_own_goes_on_to_the_same_bits(rounder, scene, tmp_path):
    train_until_killed(6, scene, tmp_path / "run", ENDED, terms=terms())
    pipeline.train(scene, tmp_path / "run", ENDED, terms=terms(), resume=True)
    assert (tmp_path / "run/gaussians.ply").read_bytes() == (rounder / "gaussians.ply").read_bytes()


def test_a_weight_without_its_term_is_one_line_before_anything_is_written(scene, tmp_path):
    with pytest.raises(InputError, match=r"^phases\.round\.weights\.needles: no such term of the loss"):
        pipeline.train(scene, tmp_path / "run", ENDED)
    assert not (tmp_path / "run").exists()


def test_steps_of_several_views_are_all_of_the_run(scene, tmp_path):
    settings = config.parse(
        Settings, {**SETTINGS, "phases": [{"name": "plain", "steps": 8, "image_scale": 2}], "views_per_step": 4}
    )
    pipeline.train(scene, tmp_path / "run", settings)
    assert json_files.read(tmp_path / "run/plan.json")["steps"] == 2
    runs.update_manifest(tmp_path / "run", status="stopped")
    pipeline.report(tmp_path / "run")
    assert "not finished: 2 of 2 steps logged" in (tmp_path / "run/report.html").read_text()
