"""Data sets that another camera took: what was put into the photos is what the file says."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from photographed_wall import wall

from gsjax.effects.exposure import linear_light
from gsjax.io import runs
from gsjax.io.colmap_writer import write_model
from gsjax.io.images import write_image
from gsjax.io.scenes import load_scene

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"


@pytest.fixture
def relit(monkeypatch):
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    yield importlib.import_module("relit")
    sys.modules.pop("relit", None)


def test_light_is_changed_by_what_the_file_tells(relit, tmp_path):
    scene = wall(4)
    write_model(tmp_path / "scene/sparse/0", scene.frames, scene.points, scene.point_colors)
    for frame in scene.frames:
        write_image(tmp_path / "scene/images" / frame.name, frame.pixels().image)
    out = relit.relight(tmp_path / "scene", tmp_path / "out", exposure=0.3, balance=0.1, corner=-0.5)
    told = runs.read_json(out / "relit.json")
    np.testing.assert_allclose(np.mean(list(told["gains"].values()), axis=0), 0, atol=1e-12)
    for before, after in zip(scene.frames, load_scene(out).frames, strict=True):
        stops = np.log2(linear_light(after.pixels().image / 255) / linear_light(before.pixels().image / 255))
        middle, corner = stops[35:37, 47:49].mean((0, 1)), stops[0, 0]
        # A step of 1 / 255 at these tones is 0.03 EV.
        np.testing.assert_allclose(middle, told["gains"][before.name], atol=0.04)
        np.testing.assert_allclose(corner - middle, -0.5, atol=0.07)
