import os
import subprocess
import sys
from pathlib import Path

import pytest

from gsjax.errors import InputError
from rasterizer._native.compiled import cache_folder

BENCHMARKS = Path(__file__).resolve().parents[2] / "experiments/benchmarks"


def run(script, *arguments, folder):
    # The engine's loops are those of the session: to compile them anew takes half a minute.
    caches = {"XDG_CACHE_HOME": str(folder), "NUMBA_CACHE_DIR": str(cache_folder().parent)}
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", **caches}
    command = [sys.executable, str(BENCHMARKS / script), *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment)


@pytest.mark.long
def test_the_benchmark_runs_as_a_script_although_it_has_the_packages_name(tmp_path):
    done = run("rasterizer.py", "--only", "10k, 256x256, radius 6", "--processes", "1", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    names, figures, *machine = (line.split("  ") for line in done.stdout.splitlines())
    table = dict(
        zip([n.strip() for n in names if n.strip()], [f.strip() for f in figures if f.strip()][1:], strict=True)
    )
    assert table["pairs"] == "54,710"  # The workload is seeded.
    assert 0 < float(table["forward_ms"]) < float(table["forward_backward_ms"])
    record = {line[0]: line[-1].strip() for line in machine}
    assert "cpu" in record and record["backend"] == "native"


def test_without_a_gpu_its_script_says_so_in_one_line(tmp_path):
    done = run("rasterizer_gpu.py", folder=tmp_path)
    assert done.returncode == 2
    assert "no GPU: jax runs on 'cpu'" in done.stderr and len(done.stderr.splitlines()) == 1


def test_kernels_that_are_wrong_are_not_timed(scripts, monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    rasterizer_gpu = scripts("rasterizer_gpu")
    right = {"image": 1e-3, "means": 1e-5}
    rasterizer_gpu.require_right({"plain": right, "deep": right})
    for wrong in (0.1, float("nan")):
        with pytest.raises(InputError, match=rf"deep, means: {wrong:.2g}\): nothing is timed"):
            rasterizer_gpu.require_right({"plain": right, "deep": {**right, "means": wrong}})
