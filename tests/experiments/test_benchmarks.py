import os
import subprocess
import sys
from pathlib import Path

import pytest

from gsjax.errors import InputError
from rasterizer._native.compiled import cache_folder

BENCHMARKS = Path(__file__).resolve().parents[2] / "experiments/benchmarks"


@pytest.mark.long
def test_the_benchmark_runs_as_a_script_although_it_has_the_packages_name(tmp_path):
    # The engine's loops are those of the session: to compile them anew takes half a minute.
    caches = {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": str(cache_folder().parent)}
    command = [sys.executable, str(BENCHMARKS / "rasterizer.py"), "--only", "10k, 256x256, radius 6"]
    command += ["--processes", "1"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env={**os.environ, **caches})
    assert done.returncode == 0, done.stderr
    assert "54,710" in done.stdout, "the workload is seeded"


def test_kernels_that_are_wrong_are_not_timed(scripts, monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    rasterizer_gpu = scripts("rasterizer_gpu")
    right = {"image": 1e-3, "means": 1e-5}
    rasterizer_gpu.require_right({"plain": right, "deep": right})
    for wrong in (0.1, float("nan")):
        with pytest.raises(InputError, match=rf"deep, means: {wrong:.2g}\): nothing is timed"):
            rasterizer_gpu.require_right({"plain": right, "deep": {**right, "means": wrong}})
