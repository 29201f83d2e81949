import importlib.util
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import pytest
from small_scenes import camera_at, cloud
from tolerances import assert_close

from gsjax import render
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.ply import write_gaussians
from rasterizer._native.compiled import cache_folder

BENCHMARKS = Path(__file__).resolve().parents[2] / "experiments/benchmarks"


def run(script, *arguments, folder):
    # The engine's loops are those of the session: to compile them anew takes half a minute.
    kept = {"XDG_CACHE_HOME": str(folder), "NUMBA_CACHE_DIR": str(cache_folder())}
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", **kept}
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
    for way in ("forward", "backward"):
        times = float(table[f"{way}_ns"]) / float(record[f"limit_{way}_ns"])
        assert_close(float(table[f"{way}_over_limit"]), times, rtol=2e-3, why="all three are printed to four digits")
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
    done = run("rasterizer_peers.py", "peer.py", folder=tmp_path)
    assert (done.returncode, done.stderr.splitlines()) == (2, ["gsjax: error: peer.py: no Python file"])


@pytest.mark.skipif(importlib.util.find_spec("torch") is not None, reason="torch is installed")
def test_without_torch_gsplats_reference_is_one_line(tmp_path):
    done = run("rasterizer_peers.py", "gsplat", folder=tmp_path)
    message = "gsjax: error: gsplat: No module named 'torch': pip install gsplat torch"
    assert (done.returncode, done.stderr.splitlines()) == (2, [message])


def test_both_of_our_engines_draw_a_run_as_its_first_training_camera_sees_it(scripts, monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(BENCHMARKS)  # It holds a rasterizer.py: the package was imported with `render`.
    rasterizer_peers, peers = scripts("rasterizer_peers"), scripts("peers")
    gaussians = replace(cloud(60), pixel_filter="mip")
    held_out, camera = (camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-0.5, 0.5))
    records = [{"name": "a", "held_out": True, **vars(held_out)}, {"name": "b", "held_out": False, **vars(camera)}]
    write_gaussians(tmp_path / "gaussians.ply", gaussians)
    json_files.write(tmp_path / "config.json", {"background": "black"})
    json_files.write(tmp_path / "cameras.json", records)
    (image, gradient), (jnp_image, jnp_gradient) = rasterizer_peers.tasks(tmp_path, peers.peer_named("jnp"))
    expected = render.view(gaussians, camera, capacity=4096, background=jnp.zeros(3)).colors
    assert float(expected.max()) > 0.1
    assert_close(image(), expected)
    assert_close(jnp_image(), expected)
    assert_close(gradient(), jnp_gradient(), kind="gradient")


@pytest.fixture
def gpu_scripts(scripts, monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return scripts


def test_kernels_that_are_wrong_are_not_timed(gpu_scripts):
    rasterizer_gpu = gpu_scripts("rasterizer_gpu")
    right = {"image": 1e-3, "means": 1e-5}
    rasterizer_gpu.require_right({"plain": right, "deep": right})
    for wrong in (0.1, float("nan")):
        with pytest.raises(InputError, match=rf"deep, means: {wrong:.2g}\): nothing is timed"):
            rasterizer_gpu.require_right({"plain": right, "deep": {**right, "means": wrong}})


def test_the_estimate_shares_a_multiprocessor_and_keeps_its_work(gpu_scripts):
    estimate = gpu_scripts("gpu_estimate")
    kernel = estimate.Kernel(instructions=50.0, programs=8)
    alone = 1000 * 50 * 256 / 32 / (estimate.CLOCK * estimate.LONE)
    assert estimate.seconds([1000], kernel) == pytest.approx(alone)
    assert estimate.seconds([1000] * estimate.SMS, kernel) == pytest.approx(alone)
    # As many as there is room for: they share what a multiprocessor does in a cycle.
    many = estimate.seconds([1000] * estimate.SMS * 8, kernel)
    assert many == pytest.approx(alone * 8 * estimate.LONE / (4 * estimate.PEAK_SHARE))
    assert estimate.seconds([1000] * estimate.SMS * 16, kernel) == pytest.approx(2 * many)
    # A deep list is hidden behind the others where it is begun first, and in segments it costs what its splats do.
    others = [100] * estimate.SMS * 40
    last, first = estimate.seconds([*others, 4000], kernel), estimate.seconds([4000, *others], kernel)
    assert first < 0.95 * last and estimate.seconds(estimate.cut([*others, 4000]), kernel) < first
    assert estimate.cut([600, 0, 256]) == [256, 256, 88, 256]
