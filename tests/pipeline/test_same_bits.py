"""A run is the same to the bit on one thread as on all of a CPU's, and beside another run of the same process."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

from gsjax import pipeline, runs

PROGRAM = """
import sys, json
from gsjax import pipeline
scene, out, settings = sys.argv[1:]
pipeline.train(scene, out, json.loads(settings))
"""


def assert_same(one, other):
    assert (one / "gaussians.ply").read_bytes() == (other / "gaussians.ply").read_bytes()
    losses = [[record["loss"] for record in runs.read_metrics(folder)] for folder in (one, other)]
    assert losses[0] == losses[1] and losses[0]


def test_one_thread(first_phase, scene, tmp_path):
    """In a process of its own, which compiles its own programs."""
    reference, settings = first_phase
    own = {"NPROC": "1", "JAX_ENABLE_COMPILATION_CACHE": "false"}
    command = [sys.executable, "-c", PROGRAM, str(scene), str(tmp_path / "run"), json.dumps(settings)]
    subprocess.run(command, env={**os.environ, **own}, check=True, capture_output=True)
    assert_same(tmp_path / "run", reference)


def test_two_trainings_in_two_threads(first_phase, scene, tmp_path):
    reference, settings = first_phase

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda name: pipeline.train(scene, tmp_path / name, settings), ("one", "other")))
    for name in ("one", "other"):
        assert_same(tmp_path / name, reference)
        assert "<svg" in (tmp_path / name / "report.html").read_text()
