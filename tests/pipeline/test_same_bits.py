"""A run is the same to the bit on any number of a CPU's threads, and beside another run of the same process."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
from trained_run import SETTINGS

from gsjax import config, pipeline, runs
from gsjax.settings import Settings

PROGRAM = """
import sys, json
from gsjax import config, pipeline
from gsjax.settings import Settings
scene, out, settings = sys.argv[1:]
pipeline.train(scene, out, config.parse(Settings, json.loads(settings)))
"""


SHORT = config.merge(
    SETTINGS, {"schedule": {"phases": SETTINGS["schedule"]["phases"][:1]}, "rates": {"decay_steps": 30}}
)
"""The first phase of the run, with the programs that it compiled."""


@pytest.fixture(scope="module")
def reference(scene, tmp_path_factory):
    """Has a thread for each core. After a resume: `test_training.py`."""
    folder = tmp_path_factory.mktemp("same") / "run"
    pipeline.train(scene, folder, config.parse(Settings, SHORT))
    return folder


def assert_same(one, other):
    assert (one / "gaussians.ply").read_bytes() == (other / "gaussians.ply").read_bytes()
    losses = [[record["loss"] for record in runs.read_metrics(folder)] for folder in (one, other)]
    assert losses[0] == losses[1] and losses[0]


@pytest.mark.parametrize("threads", [1, pytest.param(4, marks=pytest.mark.long)])
def test_any_number_of_threads(reference, scene, tmp_path, threads):
    """In a process of its own, which compiles its own programs."""
    own = {"NPROC": str(threads), "JAX_ENABLE_COMPILATION_CACHE": "false"}
    command = [sys.executable, "-c", PROGRAM, str(scene), str(tmp_path / "run"), json.dumps(SHORT)]
    subprocess.run(command, env={**os.environ, **own}, check=True, capture_output=True)
    assert_same(tmp_path / "run", reference)


def test_two_trainings_in_two_threads(reference, scene, tmp_path):
    def train(name):
        pipeline.train(scene, tmp_path / name, config.parse(Settings, SHORT))

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(train, ("one", "other")))
    for name in ("one", "other"):
        assert_same(tmp_path / name, reference)
        assert "<svg" in (tmp_path / name / "report.html").read_text()
