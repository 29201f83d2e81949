"""What `gsjax train` says of what it was not given, and of what it was held back by."""

import importlib
import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from photographed_wall import wall

from gsjax.config import parse
from gsjax.errors import InputError
from gsjax.pipeline.training_journal import TrainingJournal
from gsjax.scene import with_pixels
from gsjax.settings import PRESETS, Phase, Settings, Weights
from gsjax.training.growth.rules import RULES
from gsjax.training.plan import plan

train = importlib.import_module("gsjax.pipeline.train")  # The package's attribute of that name is the function.
STANDS_IN = "no maps of normals (--normals): the run's own depth stands in for a network"
H100 = SimpleNamespace(platform="gpu", device_kind="NVIDIA H100 80GB HBM3", compute_capability="9.0")


@pytest.mark.parametrize(("weights", "said"), [({"sdf_normal": 0.2}, [STANDS_IN]), ({}, [])])
def test_without_maps_a_line_says_that_own_depth_stands_in_for_a_network(weights, said):
    settings = Settings(phases=(Phase("surface", 1, Weights(**weights)),))
    planned = train._planned("no scene", settings, {}, 1, None)
    lines = train._beginning_lines(planned, settings, "9 photos")
    assert lines == ["on the CPU with the native rasterizer", "9 photos", *said]


@pytest.mark.parametrize(("preset", "said"), [("paper_6k_15k", True), ("paper_13k_7k", True), ("fast", False)])
def test_where_3dgs_rule_grows_a_line_tells_the_bound_that_it_does_not_have(preset, said):
    settings = parse(Settings, {**PRESETS[preset], "max_gaussians": 1_234_567})
    lines = train._beginning_lines(plan(settings), settings, "9 photos")
    line = "growth stops at max_gaussians=1,234,567; 3DGS has no such bound"
    assert (line in lines) == said


def test_the_first_line_names_device_and_engine(monkeypatch):
    from gsjax.rendering import engine
    from rasterizer import engines

    for module in (engine, engines):
        monkeypatch.setattr(module, "default_device", lambda: H100)
    first, *_ = train._beginning_lines(plan(Settings()), Settings(), "9 photos")
    assert first == "on NVIDIA H100 80GB HBM3 with the pallas rasterizer"


@pytest.fixture
def journal(tmp_path):
    """One that has a run folder and a bar, and notes what the bar is told."""
    (tmp_path / "manifest.json").write_text("{}")
    journal, said = object.__new__(TrainingJournal), []
    journal.run, journal.plan, journal._held = tmp_path, plan(Settings(max_gaussians=5_000)), False
    journal.bar = SimpleNamespace(write=lambda line, file: said.append((line, file)))
    return journal, said


def progress(step, rule):
    return SimpleNamespace(step=step, phase=SimpleNamespace(rule=rule))


def test_a_run_that_may_not_grow_says_so_once(journal, tmp_path):
    journal, said = journal
    journal._tell_held(progress(1_900, RULES["adc"]), 4_999)
    assert not said
    for step in (2_000, 2_050):
        journal._tell_held(progress(step, RULES["adc"]), 5_000)
    line = "growth is held at max_gaussians=5,000 from step 2,000 on"
    assert said == [(f"train: {line}", sys.stderr)]
    assert json.loads((tmp_path / "manifest.json").read_text())["growth"] == line


@pytest.mark.parametrize("rule", [RULES["error"], None])
def test_a_full_budget_is_no_news_where_it_is_to_be_filled_or_nobody_grows(journal, rule):
    journal, said = journal
    journal._tell_held(progress(2_000, rule), 5_000)
    assert not said


def test_masks_that_leave_nothing_are_refused():
    scene = wall(3)
    bare = [with_pixels(f, f.pixels()._replace(valid=np.zeros((f.height, f.width), np.uint8))) for f in scene.frames]
    train._require_pixels(replace(scene, frames=(*bare[:2], scene.frames[2])))
    with pytest.raises(InputError, match="wall: its masks leave no pixel of any photo"):
        train._require_pixels(replace(scene, frames=tuple(bare)))
