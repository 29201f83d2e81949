"""Two sheets one behind the other, whose depth has a closed form in every reading."""

from types import SimpleNamespace

import numpy as np
import pytest
from small_scenes import camera_at, discs
from tolerances import assert_close

from gsjax.errors import InputError
from gsjax.runs import result
from gsjax.scene import Pixels, Truth, frame_of

NEAR, FAR, OPACITY = 4.0, 6.0, 0.7


@pytest.fixture
def study(scripts, monkeypatch):
    """`experiments/depth_readings.py` over a run of the two sheets; the truth is the near one."""
    module, camera = scripts("depth_readings"), camera_at()
    size = camera.height, camera.width
    pixels = Pixels(np.zeros((*size, 3), np.uint8))
    frame = frame_of("a.png", np.asarray(camera.viewmat), np.asarray(camera.K), pixels, held_out=True)
    known = Truth(depths={"a.png": lambda: np.full(size, NEAR, np.float32)})
    sheets = discs(np.array([[0, 0, NEAR], [0, 0, FAR]]), [0, 0, -1.0], 1000.0, thickness=1e-6, opacity=OPACITY)
    scene = SimpleNamespace(root="scene", held_out_frames=(frame,), truth=known)
    monkeypatch.setattr(result, "open_result", lambda folder: SimpleNamespace(gaussians=sheets))
    monkeypatch.setattr(result, "scene_of_run", lambda folder: scene)
    return SimpleNamespace(module=module, scene=scene, sheets=sheets)


def test_every_reading_is_measured_by_itself(study):
    figures = study.module.compare(["run"], ["plane", "front", "discs"])
    assert list(figures) == ["run, plane", "run, front", "run, discs"]
    behind = OPACITY * (1 - OPACITY)  # what the far sheet shows
    used = {"plane": behind, "front": 1 - OPACITY - 0.2, "discs": 0.0}  # light that ends on it; the rest ends before
    for reading, share in used.items():
        expected = (FAR - NEAR) * share / (OPACITY + share)
        assert_close(np.float32(figures[f"run, {reading}"]["depth_error"]), np.float32(expected))


def test_the_picture_shows_the_normals_of_every_reading(study):
    camera = camera_at()
    run = SimpleNamespace(gaussians=study.sheets, cameras=[camera], held_out=[True], background=np.zeros(3))
    shown = study.module.panels(run, ["plane", "discs"], 0)
    assert list(shown) == ["colours", "plane", "discs"]
    inner = np.broadcast_to([127.5, 127.5, 255], (22, 30, 3))  # what half of 255 rounds to is not asked
    np.testing.assert_allclose(shown["plane"][1:-1, 1:-1], inner, atol=0.5)
    with pytest.raises(InputError, match="--view: the run holds out 1 views; there is no view 1"):
        study.module.panels(run, ["plane"], 1)


def test_without_truth_it_is_one_line(study):
    study.scene.truth = None
    with pytest.raises(InputError, match="scene: has neither true depth nor true normals of held-out views"):
        study.module.compare(["run"], ["plane"])
