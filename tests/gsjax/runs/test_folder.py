import json
import os
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from gsjax import runs
from gsjax.errors import InputError
from gsjax.io import json_files

SETTINGS = {"seed": 3, "train": {"steps": 100, "rates": [0.1, 0.2]}}


@pytest.fixture
def run(tmp_path):
    return runs.create(tmp_path / "run", SETTINGS, scene=tmp_path / "scene", seed=3)


def test_a_new_run_says_what_was_asked_and_where_and_is_not_overwritten(run, tmp_path):
    manifest = json.loads((run / "manifest.json").read_text())
    assert json.loads((run / "config.json").read_text()) == SETTINGS
    assert (manifest["scene"], manifest["seed"], manifest["status"]) == (str(tmp_path / "scene"), 3, "started")
    assert manifest["versions"]["numpy"] == np.__version__
    with pytest.raises(InputError, match=r"run: this folder is not empty; resume its run"):
        runs.create(run, {}, scene="other", seed=0)
    assert json.loads((run / "config.json").read_text()) == SETTINGS


def test_a_run_is_reopened_on_its_own_data_set_with_its_own_settings_only(run, tmp_path):
    scene = tmp_path / "nowhere" / ".." / "scene"  # the same place, named another way
    assert runs.reopen(run, {"seed": 3, "train": {"steps": 100, "rates": (0.1, 0.2)}}, scene=scene) == run
    with pytest.raises(InputError, match=r"run: was started with train\.steps = 100, not 50"):
        runs.reopen(run, {"seed": 3, "train": {"steps": 50, "rates": [0.1, 0.2]}}, scene=scene)
    with pytest.raises(InputError, match=r"run: was started on .*/scene, not on .*/other; a resumed run keeps"):
        runs.reopen(run, SETTINGS, scene=tmp_path / "other")


def test_a_run_of_an_earlier_version_is_read_and_not_resumed(run):
    """Settings had no groups then, and knew of one depth and of no effects."""
    json_files.write(run / "config.json", {"seed": 3, "background": "white", "photos": None, "hold_out": "8"})
    assert runs.read_settings(run) == {
        "seed": 3,
        "photos": {"subset": None, "hold_out": "8"},
        "supervision": {},
        "model": {"background": "white", "depth_mode": "center", "pixel_filter": "classic"},
        "schedule": {},
        "effects": {"names": "none"},
    }
    with pytest.raises(InputError, match=r"run/config\.json: of an earlier version: hold_out is photos\.hold_out now$"):
        runs.can_resume(run)


def test_a_run_folder_appears_whole_wherever_its_making_is_killed(tmp_path):
    """Killed at each of its writes in turn, it leaves no run, and the next try makes one; or it leaves a whole one."""
    program = """
import os, sys
from gsjax import runs
replace, kinds = os.replace, ("absent", "empty")
def killed_at(count):
    def replaced(*names):
        nonlocal count
        count -= 1
        count < 0 and os._exit(9)
        replace(*names)
    return replaced
for kind in kinds:
    for count in range(6):
        run = f"{sys.argv[1]}/{kind}_{count}"
        kind == "empty" and os.mkdir(run)
        child = os.fork()
        if not child:
            os.replace = killed_at(count)
            runs.create(run, {"seed": 3}, scene="scene", seed=3, plan={"steps": 1})
            os._exit(7)
        print(kind, count, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True, check=True)
    names, writes = {"config.json", "plan.json", "manifest.json", "checkpoints"}, {"absent": 4, "empty": 3}
    for kind, count, code in map(str.split, done.stdout.splitlines()):
        run = tmp_path / f"{kind}_{count}"
        assert int(code) == (7 if int(count) >= writes[kind] else 9)
        if code == "9":
            assert not runs.is_run(run)
            assert kind == "absent" and not run.exists() or not runs.can_resume(run)
            runs.create(run, {"seed": 3}, scene="scene", seed=3, plan={})
        assert names <= set(os.listdir(run)) and json_files.read(run / "config.json") == {"seed": 3}
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")], "the next has swept"


def test_what_is_to_be_resumed_is_a_run(run, tmp_path, capsys):
    assert runs.can_resume(run)
    with pytest.raises(InputError, match="absent: there is no run to resume; without resume one begins"):
        runs.can_resume(tmp_path / "absent")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("kept")
    with pytest.raises(InputError, match=r"mine: holds no manifest\.json; it is no run folder"):
        runs.can_resume(tmp_path / "mine")
    (tmp_path / "killed/checkpoints").mkdir(parents=True)
    (tmp_path / "killed/config.json").write_text("{}")  # as versions before this one were killed
    assert not runs.can_resume(tmp_path / "killed")
    assert capsys.readouterr().err.endswith("killed: a run was stopped as it began here; it begins anew\n")
    assert runs.create(tmp_path / "killed", SETTINGS, scene="scene", seed=3)


def test_a_run_may_be_a_link(tmp_path):
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "disk/run")
    assert runs.create(link, SETTINGS, scene="scene", seed=3) == link
    assert link.is_symlink() and runs.is_run(tmp_path / "disk/run")
    with pytest.raises(InputError, match="no room"), runs.claim_run(link):
        raise InputError("the device has no room")
    assert link.is_symlink() and os.listdir(link) == []
    runs.create(link, SETTINGS, scene="scene", seed=3)


def test_two_processes_do_not_work_in_one_folder(run):
    holding = (
        "import sys, time\nfrom pathlib import Path\nfrom gsjax import runs\n"
        "with runs.claim_run(Path(sys.argv[1])):\n    print(flush=True)\n    time.sleep(60)"
    )
    child = subprocess.Popen([sys.executable, "-c", holding, str(run)], stdout=subprocess.PIPE)
    child.stdout.readline()
    for attempt in (lambda: runs.claim_run(run).__enter__(), lambda: runs.can_resume(run)):
        with pytest.raises(InputError, match="run: another process is at work in this folder"):
            attempt()
    assert runs.is_run(run), "its files are the other's"
    child.kill()
    child.wait()
    child.stdout.close()
    with runs.claim_run(run):
        pass


def test_a_damaged_newest_checkpoint_gives_way_to_the_one_before(run, capsys):
    for step in (5, 10):
        runs.save_checkpoint(run, step, {"step": np.int32(step)})
    newest = run / "checkpoints/step_0000010.npz"
    newest.write_bytes(newest.read_bytes()[:-30])
    with runs.claim_run(run):
        assert runs.latest_checkpoint(run)[0] == 5
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "step_0000010.npz: truncated or damaged" in line
    assert line.endswith("resuming from step_0000005.npz\n")
    (run / "checkpoints/step_0000005.npz").write_bytes(b"")
    message = "step_0000005.npz: .*without this file, resuming begins at"
    with pytest.raises(InputError, match=message), runs.claim_run(run):
        pass
    assert (run / "checkpoints/step_0000005.npz").exists() and runs.is_run(run)


@pytest.mark.parametrize("left", ["nothing", "metrics", "checkpoint"])
def test_a_run_of_which_nothing_came_leaves_its_place_free(run, left):
    with pytest.raises(InputError, match="no room"), runs.claim_run(run):
        if left == "metrics":
            runs.append_metrics(run, {"step": 5})
        if left == "checkpoint":
            runs.save_checkpoint(run, 7, {"step": np.int32(7)})
        raise InputError("the device has no room")
    assert run.exists() == (left != "nothing")


def test_the_newest_two_checkpoints_stay(run):
    assert runs.latest_checkpoint(run) is None
    for step in (5, 90, 1234567):
        runs.save_checkpoint(run, step, {"step": np.int32(step)})
    assert runs.latest_checkpoint(run) == (1234567, run / "checkpoints/step_1234567.npz")
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
