import json
import os
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from gsjax import runs
from gsjax.errors import InputError
from gsjax.io import json_files, machine
from gsjax.runs import checkpoints

SETTINGS = {"seed": 3, "train": {"steps": 100, "rates": [0.1, 0.2]}}


@pytest.fixture
def run(tmp_path):
    return runs.create(tmp_path / "run", SETTINGS, scene=tmp_path / "scene", seed=3)


def test_a_new_run_says_what_was_asked_and_where(run, tmp_path):
    manifest = json.loads((run / "manifest.json").read_text())
    assert json.loads((run / "config.json").read_text()) == SETTINGS
    assert manifest["scene"] == str(tmp_path / "scene")
    assert manifest["seed"] == 3
    assert manifest["status"] == "started"
    assert manifest["versions"]["numpy"] == np.__version__
    assert manifest["machine"]["cores"] == len(os.sched_getaffinity(0))
    assert manifest["machine"]["accelerator"] is None


def test_nothing_is_overwritten(run):
    before = (run / "config.json").read_bytes()
    with pytest.raises(InputError, match=r"run: this folder is not empty; continue its run with --resume"):
        runs.create(run, {}, scene="other", seed=0)
    assert (run / "config.json").read_bytes() == before


def test_a_run_is_reopened_on_its_own_data_set_with_its_own_settings_only(run, tmp_path):
    scene = tmp_path / "nowhere" / ".." / "scene"  # the same place, named another way
    leftover = run / "checkpoints/.step_0000001-0123abcd.npz"
    leftover.write_text("half")
    assert runs.reopen(run, {"seed": 3, "train": {"steps": 100, "rates": (0.1, 0.2)}}, scene=scene) == run
    assert not leftover.exists()
    with pytest.raises(InputError, match=r"run: was started with train\.steps = 100, not 50"):
        runs.reopen(run, {"seed": 3, "train": {"steps": 50, "rates": [0.1, 0.2]}}, scene=scene)
    with pytest.raises(InputError, match=r"was started with extra = null, not 1"):
        runs.reopen(run, SETTINGS | {"extra": 1}, scene=scene)
    with pytest.raises(InputError, match=r"config\.json: No such file or directory"):
        runs.reopen(run / "nothing", SETTINGS, scene=scene)
    with pytest.raises(InputError, match=r"run: was started on .*/scene, not on .*/other; a resumed run keeps"):
        runs.reopen(run, SETTINGS, scene=tmp_path / "other")


def test_what_the_version_of_a_run_did_not_know_is_completed_before_it_is_compared(run, tmp_path):
    asked = SETTINGS | {"train": {**SETTINGS["train"], "later": 0.0}}

    def completed(started):
        return started | {"train": {"later": 0.0, **started["train"]}}

    with pytest.raises(InputError, match=r"was started with train\.later = null, not 0\.0"):
        runs.reopen(run, asked, scene=tmp_path / "scene")
    assert runs.reopen(run, asked, scene=tmp_path / "scene", completed=completed) == run
    with pytest.raises(InputError, match=r"was started with train\.later = 0\.0, not 1\.0"):
        runs.reopen(
            run, asked | {"train": {**asked["train"], "later": 1.0}}, scene=tmp_path / "scene", completed=completed
        )


def test_a_run_from_before_depth_could_be_chosen_keeps_the_depth_that_it_had(run, tmp_path):
    assert runs.read_settings(run) == {**SETTINGS, "depth_mode": "center", "pixel_filter": "classic", "effects": "none"}
    assert runs.reopen(run, SETTINGS | {"depth_mode": "center"}, scene=tmp_path / "scene") == run
    with pytest.raises(InputError, match=r'was started with depth_mode = "center", not "plane"'):
        runs.reopen(run, SETTINGS | {"depth_mode": "plane"}, scene=tmp_path / "scene")
    json_files.write(run / "config.json", SETTINGS | {"depth_mode": "plane"})
    assert runs.read_settings(run)["depth_mode"] == "plane"


@pytest.mark.parametrize("left", ["nothing", "metrics", "checkpoint"])
def test_a_run_of_which_nothing_came_leaves_its_place_free(run, left):
    with pytest.raises(InputError, match="no room"), runs.begun(run):
        if left == "metrics":
            runs.append_metrics(run, {"step": 5})
        if left == "checkpoint":
            runs.save_checkpoint(run, 7, {"step": np.int32(7)})
        raise InputError("the device has no room")
    assert run.exists() == (left != "nothing")


def test_a_run_that_is_interrupted_stays(run):
    with pytest.raises(KeyboardInterrupt), runs.begun(run):
        raise KeyboardInterrupt
    assert (run / "manifest.json").exists()


def test_the_newest_two_checkpoints_stay(run):
    assert runs.latest_checkpoint(run) is None
    for step in (5, 90, 1234567):
        runs.save_checkpoint(run, step, {"step": np.int32(step)})
    step, path = runs.latest_checkpoint(run)
    assert (step, path.name) == (1234567, "step_1234567.npz")
    assert checkpoints.load_arrays(path)["['step']"] == step
    assert sorted(os.listdir(run / "checkpoints")) == ["step_0000090.npz", "step_1234567.npz"]


def test_metrics_are_cut_back_to_the_resumed_step(run):
    for step in (10, 20, 30):
        runs.append_metrics(run, {"step": step, "loss": jnp.float32(0.5), "psnr": float("nan")})
    with open(run / "metrics.jsonl", "a") as file:
        file.write('{"step": 40, "lo')  # Killed here.
    assert [record["step"] for record in runs.read_metrics(run)] == [10, 20, 30]
    runs.truncate_metrics(run, 20)
    runs.append_metrics(run, {"step": 21})
    assert (run / "metrics.jsonl").read_text().splitlines() == [
        '{"step": 10, "loss": 0.5, "psnr": null}',
        '{"step": 20, "loss": 0.5, "psnr": null}',
        '{"step": 21}',
    ]


def test_the_manifest_lists_the_files(run):
    runs.append_metrics(run, {"step": 1})
    runs.save_checkpoint(run, 1, {"x": np.zeros(1)})
    runs.update_manifest(run, status="done", train_seconds=np.float64(1.5))
    manifest = json_files.read(run / "manifest.json")
    assert manifest["status"] == "done"
    assert manifest["train_seconds"] == 1.5
    assert manifest["seed"] == 3
    assert manifest["files"] == ["checkpoints/step_0000001.npz", "config.json", "manifest.json", "metrics.jsonl"]


def test_json_holds_plain_numbers(tmp_path):
    data = {"a": np.float32(0.5), "b": jnp.arange(2, dtype=jnp.int32), "c": (np.inf, tmp_path), 3: np.bool_(True)}
    json_files.write(tmp_path / "x.json", data)
    assert json_files.read(tmp_path / "x.json") == {"a": 0.5, "b": [0, 1], "c": [None, str(tmp_path)], "3": True}


def test_what_is_no_json_is_one_line(tmp_path):
    (tmp_path / "x.json").write_text("{")
    with pytest.raises(InputError, match=r"x\.json: is no JSON"):
        json_files.read(tmp_path / "x.json")


def test_metrics_on_a_full_disk(run):
    (run / "metrics.jsonl").symlink_to("/dev/full")
    with pytest.raises(InputError, match=r"cannot write .*metrics\.jsonl: No space left on device"):
        runs.append_metrics(run, {"step": 1})


def test_peak_memory_is_the_process_s_own_and_does_not_fall(tmp_path):
    # However large the process that starts it: `ru_maxrss` would begin with that one's.
    program = """
import numpy as np
from gsjax.io.machine import peak_memory
before = peak_memory()
block = np.ones(300 * 2**20, np.uint8)
del block
print(before, peak_memory())
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    before, after = map(int, done.stdout.split())
    assert before < 200 * 2**20
    assert after > before + 250 * 2**20
    (tmp_path / "status").write_text("VmPeak:\t 900 kB\nVmHWM:\t  512 kB\n")
    assert machine.peak_memory(tmp_path / "status") == 512 * 1024
    assert machine.peak_memory(tmp_path / "absent") > 2**20


def test_cpu_flags_are_those_of_the_file(tmp_path):
    (tmp_path / "cpuinfo").write_text("processor : 0\nflags\t\t: fpu avx512f\nprocessor : 1\nflags : other\n")
    assert machine.cpu_flags(tmp_path / "cpuinfo") == {"fpu", "avx512f"}
    assert machine.cpu_flags(tmp_path / "absent") == frozenset()
