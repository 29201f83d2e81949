"""Two processes that train one run, and what is left when one is lost."""

import os
import socket
import subprocess
import sys
import time

import pytest
from small_scenes import built_in

from gsjax import runs
from gsjax.io import json_files
from gsjax.runs import checkpoints

PATIENCE = 900  # seconds until the first checkpoint, on a machine with much else to do
LOST = (
    'schedule.phases=[{"name":"vanilla","steps":100000,"density_control":true}]',
    "model.max_gaussians=400",
    "model.sh_degree=0",
    "density.rule=error",
    "logging.metrics_every=2",
    "logging.evaluate_every=0",
    "logging.checkpoint_every=2",
)
SHORT = (  # of the preset `fast`: every kind of step, in a minute
    "schedule.phases.coarse.steps=8",
    "schedule.phases.vanilla.steps=4",
    "schedule.phases.surface.steps=8",
    "density.start=1",
    "density.stop=10",
    "density.every=4",
    "model.max_gaussians=400",
    "logging.evaluate_every=0",
    "effects.names=exposure,vignetting,poses,background",
)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def both(request, tmp_path):
    """Both processes of a run in `tmp_path`/run with the given settings; their output is in 0.log and 1.log."""
    scene, port = built_in(tmp_path / "scene", 6, (32, 32)), free_port()
    started = []
    for process in range(2):
        log = open(tmp_path / f"{process}.log", "w")  # noqa: SIM115
        command = [sys.executable, "-m", "gsjax", "train", str(scene), "--out", str(tmp_path / "run")]
        command += f"--coordinator 127.0.0.1:{port} --processes 2 --process {process} --set".split()
        command += request.param
        started.append(subprocess.Popen(command, stdout=log, stderr=log, env={**os.environ, "TMPDIR": str(tmp_path)}))
        log.close()
    yield started
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.long
@pytest.mark.parametrize("both", [SHORT], indirect=True)
def test_two_processes_train_fast_with_effects_to_the_end(both, tmp_path):
    ends = [process.wait(PATIENCE) for process in both]
    assert ends == [0, 0], "".join((tmp_path / f"{process}.log").read_text() for process in range(2))
    state = checkpoints.load_arrays(runs.latest_checkpoint(tmp_path / "run")[1])
    assert int(state["['state'].step"]) == 10  # twenty photos, two a step
    manifest = json_files.read(tmp_path / "run" / "manifest.json")
    assert set(manifest["effects"]["simulated"]) == {"exposure", "vignetting", "poses", "background"}
    assert any("exposure" in name for name in state)


@pytest.mark.long
@pytest.mark.parametrize("both", [LOST], indirect=True)
def test_a_lost_process_ends_the_run_with_one_line_and_the_last_checkpoint_whole(both, tmp_path):
    run, deadline = tmp_path / "run", time.monotonic() + PATIENCE
    while runs.latest_checkpoint(run) is None and time.monotonic() < deadline:
        assert all(process.poll() is None for process in both), (tmp_path / "0.log").read_text()
        time.sleep(0.2)
    both[1].kill()
    assert both[0].wait(PATIENCE) == 2
    log = (tmp_path / "0.log").read_text().splitlines()
    assert log[-1] == "gsjax: error: another process of this run was lost; resume from the last checkpoint"
    assert "Traceback" not in "".join(log)
    step, path = runs.latest_checkpoint(run)
    arrays = checkpoints.load_arrays(path)
    assert int(arrays["['state'].step"]) == step > 0
    assert len(arrays["['state'].gaussians.means"]) == int(arrays["['rows']"])
    assert "step/s" not in (tmp_path / "1.log").read_text(), "the first process alone speaks"
