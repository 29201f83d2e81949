"""Damaged run folders, checkpoints and records of networks: used, or refused in one line."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest
from fuzzing import damaged_json, fuzz, fuzz_files
from small_scenes import camera_at, cloud

from gsjax import config, runs
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.io import json_files
from gsjax.io.ply import write_gaussians
from gsjax.networks.records import NETWORKS
from gsjax.pipeline.normals import read_network
from gsjax.presets import preset
from gsjax.report.page import report
from gsjax.runs import checkpoints
from gsjax.runs.journal import starting_point
from gsjax.runs.photo_effects import read_photo_effects
from gsjax.runs.result import open_result, scene_of_run


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class State:
    """As much of a training's state as `beginning` reads."""

    gaussians: Gaussians
    step: np.ndarray


CAMERA = camera_at((0.0, 0.0, 0.0), (0.0, 0.0, 4.0), size=(24, 20))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run, made without training."""
    run = tmp_path_factory.mktemp("runs") / "run"
    settings = config.to_dict(preset("fast", {"photos": {"downscale": 2}}))
    runs.create(run, settings, scene=run / "absent", seed=0)
    write_gaussians(run / "gaussians.ply", cloud(20))
    view = {"width": 24, "height": 20, "viewmat": CAMERA.viewmat, "K": CAMERA.K, "held_out": False}
    names = [f"{i}.png" for i in range(3)]
    json_files.write(run / "cameras.json", [{"name": name, **view} for name in names])
    look, move = {"log_gains": [0.1, 0, 0], "falloff": [0, 0]}, {"turn": [0, 0, 0], "shift": [0, 0, 0], "focal": 1}
    for file, each in (("effects.json", look), ("poses.json", move)):
        json_files.write(run / file, {"photos": dict.fromkeys(names, each)})
    json_files.write(run / "background.json", {"sh": [[0.1, 0.2, 0.3]]})
    for step in (5, 10):
        record = {"step": step, "loss": 0.5, "psnr": 20.0, "gaussians": 20, "seconds": 1.5 * step, "phase": "coarse"}
        runs.append_metrics(run, record)
    evidence = {"on": True, "evidence": 0.2, "noise": None, "threshold": 0.1, "unit": "EV", "note": "seen"}
    record = {"simulated": ["exposure"], "evidence": {"exposure": evidence}}
    stages = {"eval": {"seconds": 3.0, "peak_gib": 1.0, "psnr": 21.0, "floor": {"chamfer": 0.1}}}
    runs.update_manifest(
        run, status="done", effects=record, stages=stages, psnr=21.0, ssim=0.8, steps=10, train_seconds=15.0, photos="3"
    )
    return run


JSONS = ("config.json", "manifest.json", "cameras.json", "effects.json", "poses.json", "background.json")


@pytest.mark.parametrize("name", [*JSONS, "metrics.jsonl"])
def test_fuzz_the_files_of_a_run(whole, tmp_path, name):
    run = tmp_path / "run"
    shutil.copytree(whole, run)
    text = (run / name).read_bytes()

    def read(using):
        """Whether what is read can be used; that its data set is not there is no fault of the file."""
        try:
            using(run)
        except InputError as error:
            if "absent" not in str(error):
                raise

    def attempt(random):
        lines = text.splitlines(keepends=True) if name.endswith("l") else [text]
        lines[0] = damaged_json(json.loads(lines[0]), random) + b"\n"
        (run / name).write_bytes(b"".join(lines))
        for using in (read_photo_effects, open_result, scene_of_run, runs.read_metrics):
            read(using)
        report(run)

    assert all(fuzz(attempt, usual=60))


def test_fuzz_checkpoints(tmp_path):
    """What is read of a damaged file has the run's own structure, shapes and types."""
    path = tmp_path / "checkpoints" / "step_0000005.npz"
    state = State(cloud(20), np.int32(5))
    stored = {"state": state, "rows": np.int64(20), "capacity": np.int64(9), "seconds": np.float64(1.5)}
    checkpoints.save(path, stored)
    (tmp_path / "metrics.jsonl").write_text("")

    def read():
        start = starting_point(tmp_path, lambda rows: State(cloud(rows or 20), np.int32(0)))
        assert start.state.gaussians.means.shape == (20, 3)

    assert all(fuzz_files(read, path, usual=150))


def test_fuzz_records_of_networks(tmp_path):
    file = tmp_path / "net.json"
    json_files.write(file, config.to_dict(NETWORKS["dsine"]))
    assert all(fuzz_files(lambda: read_network(file), file, usual=200))


def test_a_checkpoint_of_no_time_is_damaged(tmp_path):
    stored = {"state": State(cloud(20), np.int32(5)), "rows": np.int64(20), "capacity": np.int64(9)}
    checkpoints.save(tmp_path / "checkpoints" / "step_0000005.npz", stored | {"seconds": np.float64(np.nan)})
    with pytest.raises(InputError, match=r"step_0000005.npz: damaged checkpoint, its step, capacity or seconds are"):
        starting_point(tmp_path, lambda rows: State(cloud(rows or 20), np.int32(0)))
