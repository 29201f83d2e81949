import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "experiments/benchmarks"


def run(script, *arguments, folder):
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "XDG_CACHE_HOME": str(folder)}
    command = [sys.executable, str(BENCHMARKS / script), *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment)


def test_the_benchmark_runs_as_a_script_although_it_has_the_packages_name(tmp_path):
    done = run("rasterizer.py", "--only", "10k, 256x256, radius 6", "--processes", "1", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    names, figures, *machine = (line.split("  ") for line in done.stdout.splitlines())
    table = dict(
        zip([n.strip() for n in names if n.strip()], [f.strip() for f in figures if f.strip()][1:], strict=True)
    )
    assert table["pairs"] == "54,710"  # The workload is seeded.
    assert 0 < float(table["forward_ms"]) < float(table["forward_backward_ms"])
    record = {line[0]: line[-1] for line in machine}
    assert "cpu" in record
    # The blend's own operations, counted on its jaxpr: the walk back does all that the walk there does.
    assert 30 < int(record["operations_forward"]) < int(record["operations_backward"]) < 100


def test_without_a_gpu_the_gpu_scripts_say_so_in_one_line(tmp_path):
    for script, message in (
        ("rasterizer_gpu.py", "no GPU: jax runs on 'cpu'"),
        ("kernel_report.py", "no CUDA compiler"),
    ):
        done = run(script, folder=tmp_path)
        assert done.returncode == 2
        assert message in done.stderr and len(done.stderr.splitlines()) == 1


def test_a_peer_that_is_not_there_is_one_line(tmp_path):
    done = run("beside.py", "peer.py", folder=tmp_path)
    assert (done.returncode, done.stderr.splitlines()) == (2, ["gsjax: error: peer.py: no Python file"])


@pytest.mark.skipif(importlib.util.find_spec("torch") is not None, reason="torch is installed")
def test_without_torch_gsplats_reference_is_one_line(tmp_path):
    done = run("beside.py", "gsplat", folder=tmp_path)
    message = "gsjax: error: gsplat: No module named 'torch': pip install gsplat torch"
    assert (done.returncode, done.stderr.splitlines()) == (2, [message])
