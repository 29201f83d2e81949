import runpy
import sys
from pathlib import Path
from types import ModuleType

import pytest

import gsjax
from gsjax import config
from gsjax.errors import InputError
from gsjax.settings import DEMO, PRESETS, Settings

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
CONFIGS = sorted(path.stem for path in (EXPERIMENTS / "configs").glob("*.py"))


@pytest.fixture
def script(monkeypatch):
    """The names of `experiments/train.py`, with a stand-in for the pipeline, which is tested by itself."""
    pipeline = ModuleType("gsjax.pipeline")
    pipeline.calls = []
    pipeline.train = lambda scene, out, settings: pipeline.calls.append(("train", scene, out, settings))
    pipeline.mesh = lambda run, out: pipeline.calls.append(("mesh", run, out))
    pipeline.evaluate = lambda run, mesh: {"psnr": 29.0}
    monkeypatch.setitem(sys.modules, "gsjax.pipeline", pipeline)
    monkeypatch.setattr(gsjax, "pipeline", pipeline, raising=False)
    return runpy.run_path(str(EXPERIMENTS / "train.py")) | {"calls": pipeline.calls}


@pytest.mark.parametrize("name", CONFIGS)
def test_every_config_parses_and_differs_from_base_in_what_it_says(script, name):
    settings = script["load_settings"](name)
    base, own = script["load_config"]("base"), script["load_config"](name)
    assert settings == config.parse(Settings, config.merge(base, own))
    if name != "base":
        assert all(base.get(key) != value for key, value in own.items()), "a config holds differences only"


def test_the_base_is_the_fast_preset_without_effects(script):
    assert script["load_settings"]("base") == config.parse(Settings, PRESETS["fast"] | {"effects": "none"})


def test_the_demo_is_what_the_command_trains(script):
    assert script["load_settings"]("demo") == config.parse(Settings, DEMO)


def test_assignments_come_last(script):
    assert script["load_settings"]("smoke", ["phases.0.steps=3", "seed=9"]).phases[0].steps == 3


def test_unknown_names_are_answered_with_the_nearest(script):
    with pytest.raises(InputError, match="no config 'foxx' in .*; the nearest is 'fox'"):
        script["load_settings"]("foxx")
    with pytest.raises(
        InputError, match="--set: unknown key 'phases.0.step'; the nearest known one is 'phases.0.steps'"
    ):
        script["load_settings"]("fox", ["phases.0.step=3"])


def test_a_run_trains_meshes_and_writes_its_figures(script, tmp_path):
    figures = script["run"]("smoke", "scene", str(tmp_path), ["seed=2"])
    (_, scene, out, settings), mesh = script["calls"]
    assert (scene, out, settings.seed) == ("scene", str(tmp_path), 2)
    assert mesh == ("mesh", str(tmp_path), tmp_path / "mesh.ply")
    assert figures == {"psnr": 29.0}
    assert (tmp_path / "evaluation.json").read_text() == '{\n  "psnr": 29.0\n}\n'
