import os
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).resolve().parents[2] / "experiments/benchmarks/rasterizer.py"


def test_the_benchmark_runs_as_a_script_although_it_has_the_packages_name(tmp_path):
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--only", "10k, 256 px, radius 6"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "JAX_PLATFORMS": "cpu", "XDG_CACHE_HOME": str(tmp_path)},
        check=True,
    )
    names, figures, *machine = (line.split("  ") for line in done.stdout.splitlines())
    table = dict(
        zip([n.strip() for n in names if n.strip()], [f.strip() for f in figures if f.strip()][1:], strict=True)
    )
    assert table["pairs"] == "54,710"  # The workload is seeded.
    assert 0 < float(table["forward_ms"]) < float(table["forward_backward_ms"])
    assert machine[0][0] == "cpu"
