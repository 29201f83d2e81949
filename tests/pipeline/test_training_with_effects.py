"""The same with effects: what is told of them, and that nothing of them is left where there are none."""

import numpy as np
import pytest
from trained_run import SETTINGS, train_until_killed

from gsjax import config, pipeline, runs
from gsjax.io import json_files
from gsjax.runs.checkpoints import load_arrays
from gsjax.runs.result import open_result, scene_of_run


def test_a_run_with_effects_tells_of_them_and_goes_on_to_the_same_bits(run, scene, tmp_path, monkeypatch):
    """Its photos are clean: `auto` takes nothing in and ends with the bits of a run that was not asked."""
    short = {"schedule": {"phases": [{"name": "vanilla", "steps": 16, "density_control": True}]}}
    settings = config.merge(SETTINGS, short, {"effects": {"names": "exposure,vignetting,poses,background"}})
    whole, stopped, auto = (tmp_path / name for name in ("whole", "stopped", "auto"))
    summary = pipeline.train(scene, whole, settings)
    train_until_killed(9, scene, stopped, settings)
    with monkeypatch.context() as patched:  # The other is scored.
        patched.setitem(pipeline.train.__globals__, "score_images", lambda *_, **__: {"psnr": 0})
        pipeline.train(scene, stopped, settings, resume=True)
    for file in ("gaussians.ply", "effects.json", "poses.json", "cameras.json", "background.json"):
        assert (stopped / file).read_bytes() == (whole / file).read_bytes()

    manifest = json_files.read(whole / "manifest.json")
    assert manifest["effects"]["simulated"] == ["exposure", "vignetting", "poses", "background"]
    assert manifest["effects"]["evidence"]["exposure"]["threshold"] == 0.05
    scores = {f"{name}{way}" for name in ("psnr", "ssim") for way in ("", "_near_gains", "_track_gains", "_fitted")}
    aligned = {f"{name}_aligned" for name in scores}
    assert scores | aligned <= summary.keys()
    assert summary["psnr_fitted"] > summary["psnr"]
    assert summary["psnr_track_gains_aligned"] >= summary["psnr_track_gains"]
    assert manifest["cameras"].startswith("cameras turned by ")
    evaluated = pipeline.evaluate(whole)
    for name in scores:
        assert evaluated[name] == pytest.approx(summary[name], abs=1e-3), name
    assert summary["psnr_near_gains"] != summary["psnr_track_gains"]
    photos = json_files.read(whole / "effects.json")["photos"]
    records = json_files.read(whole / "cameras.json")
    held_out = {record["name"] for record in records if record["held_out"]}
    gains = np.array([photo["log_gains"] for name, photo in photos.items() if name not in held_out])
    assert gains.shape == (7, 3)
    np.testing.assert_allclose(gains.mean(0), 0, atol=1e-6)

    # Later stages see the cameras that training moved; those that are held out are where they were.
    viewmats = {record["name"]: np.array(record["viewmat"]) for record in json_files.read(run / "cameras.json")}
    for frame, record in zip(scene_of_run(whole).frames, records, strict=True):
        np.testing.assert_array_equal(frame.viewmat, np.float32(record["viewmat"]))
        np.testing.assert_array_equal(frame.K, np.float32(record["K"]))
        off = np.abs(viewmats[frame.name] - record["viewmat"]).max()
        assert off == 0 if frame.held_out else 1e-6 < off < 0.05, frame.name

    assert open_result(whole).background.shape == (1, 3), "the built-in scene stands before one white"

    pipeline.train(scene, auto, config.merge(SETTINGS, {"effects": {"names": "auto"}}))
    assert json_files.read(auto / "manifest.json")["effects"]["simulated"] == []
    assert (auto / "gaussians.ply").read_bytes() == (run / "gaussians.ply").read_bytes()
    assert not any((auto / name).exists() for name in ("effects.json", "poses.json", "background.json"))
    stored = [set(load_arrays(runs.latest_checkpoint(folder)[1])) for folder in (run, auto, whole)]
    assert stored[0] == stored[1] == {name for name in stored[2] if "effects" not in name} < stored[2]
