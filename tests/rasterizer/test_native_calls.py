"""How XLA calls the native loops: transformations, threads, interrupts, and what stands in where they are missing."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import cloud, evaluate, loss, render, stacks
from tolerances import assert_close

import rasterizer
from rasterizer import engines
from rasterizer._native import compiled
from rasterizer._native.vectors import LANES
from rasterizer.similarity import ssim

compare = jax.jit(jax.value_and_grad(partial(ssim, backend="native")))


def results():
    """An image and gradients of `cloud`, and the SSIM of two pictures with its gradient."""
    image, _, _, gradient = evaluate(cloud(), "native")
    pictures = np.random.default_rng(0).random((2, 150, 200, 3), np.float32)
    return [np.asarray(each) for each in (image, gradient.means, gradient.opacities, *compare(*pictures))]


ALONE = """
import sys
sys.path[:0] = ["tests", "tests/rasterizer"]
import numpy as np
from test_native_calls import results
np.savez(sys.argv[1], *results())
"""


def results_elsewhere(folder, **environment):
    """`results` by a process with variables of its own."""
    target, variables = folder / "arrays.npz", {**os.environ, **environment}
    subprocess.run([sys.executable, "-c", ALONE, str(target)], check=True, env=variables, cwd=engines_root())
    with np.load(target) as saved:
        return [saved[name] for name in saved.files]


def test_the_same_bits_from_call_to_call_and_with_one_thread(tmp_path):
    first = results()
    for _ in range(10):
        jax.tree.map(np.testing.assert_array_equal, results(), first)
    jax.tree.map(np.testing.assert_array_equal, results_elsewhere(tmp_path, NPROC="1"), first)


@pytest.mark.long
@pytest.mark.skipif(LANES == 8, reason="the processor has no wider vectors")
def test_vectors_of_eight_lanes_agree_with_those_of_sixteen(tmp_path):
    narrow = {"NUMBA_CPU_NAME": "x86-64-v3", "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma"}
    image, *gradients = results_elsewhere(tmp_path, **narrow)
    expected, *expected_gradients = results()
    assert_close(image, expected)
    assert_close(gradients, expected_gradients, kind="gradient")


def engines_root():
    return os.path.dirname(os.path.dirname(engines.__file__))


def test_scan_eager_and_donation_are_the_compiled_call():
    scene = cloud()

    def one(opacities):
        return render(replace(scene, opacities=opacities), capacity=2048, backend="native")[0]

    np.testing.assert_array_equal(render(scene, backend="native")[0], one(scene.opacities))
    opacities = jnp.stack([scene.opacities, 0.5 * scene.opacities])
    each = [one(row) for row in opacities]
    _, scanned = jax.lax.scan(lambda carry, row: (carry, one(row)), 0, opacities)
    assert_close(scanned, np.stack(each))
    donated = jax.jit(lambda row: (one(row), 2 * row), donate_argnums=0)
    assert_close(donated(opacities[1] + 0)[0], each[1])


def test_without_the_loops_a_cpu_renders_in_jnp_and_says_so_once(monkeypatch, caplog):
    def missing():
        raise ImportError("No module named 'numba'")

    monkeypatch.setattr(engines, "load_loops", missing)
    engines._why_no_loops.cache_clear()
    engines._log_once.cache_clear()
    try:
        assert [engines.resolve("auto") for _ in range(3)] == ["xla"] * 3
        assert [record.message for record in caplog.records] == [
            "the CPU's rasterizer runs in jnp, several times slower than its native loops: No module named 'numba'"
        ]
        with pytest.raises(ImportError):
            render(cloud(), capacity=2047, backend="native")  # Of another capacity than any program that is kept.
    finally:
        engines._why_no_loops.cache_clear()


def test_another_interface_of_xla_is_refused_by_its_version(monkeypatch, tmp_path):
    header = tmp_path / "xla" / "ffi" / "api" / "c_api.h"
    header.parent.mkdir(parents=True)
    for major, minor, fits in [(0, compiled.API_MINOR, True), (0, compiled.API_MINOR + 4, True), (1, 0, False)]:
        header.write_text(f"#define XLA_FFI_API_MAJOR {major}\n#define XLA_FFI_API_MINOR {minor}\n")
        monkeypatch.setattr(jax.ffi, "include_dir", lambda: str(tmp_path))
        if fits:
            compiled._check_interface()
        else:
            with pytest.raises(ImportError, match=r"version 1\.0, not 0\.3 or later"):
                compiled._check_interface()


STRESS = """
import json, sys, threading, time
sys.path.insert(0, "tests")
import jax, jax.numpy as jnp, numpy as np
from scenes import cloud, loss
scene = cloud(400, size=(120, 90))
step = jax.jit(lambda s: jax.value_and_grad(lambda s: loss(s, capacity=8192, backend="native")[0])(s))
value, gradient = jax.block_until_ready(step(scene))
wrong, calls = [], [0]
until = time.monotonic() + float(sys.argv[1])
def work():
    while time.monotonic() < until:
        v, g = step(scene)
        if float(v) != float(value) or not (np.asarray(g.means) == np.asarray(gradient.means)).all():
            wrong.append(float(v))
        calls[0] += 1
threads = [threading.Thread(target=work) for _ in range(6)]
for t in threads: t.start()
for t in threads: t.join()
print(json.dumps({"wrong": len(wrong), "calls": calls[0]}))
"""


def test_six_threads_at_once_neither_hang_nor_differ():
    """GSJAX_STRESS_SECONDS asks for more than the few seconds of every day."""
    seconds = float(os.environ.get("GSJAX_STRESS_SECONDS", "1"))
    command, how = [sys.executable, "-c", STRESS, str(seconds)], {"capture_output": True, "text": True}
    done = subprocess.run(command, cwd=engines_root(), timeout=seconds + 120, **how)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout.splitlines()[-1])
    assert report["wrong"] == 0 and report["calls"] > 6


@partial(jax.jit, static_argnames="capacity")
def with_medians_and_masks(scene, capacity=None):
    options = {"return_median_depth": True, "backend": "native"}
    masks = jnp.arange(20).reshape(1, 4, 5) % 7 > 0
    (_, rest), gradient = jax.value_and_grad(loss, has_aux=True)(scene, capacity=capacity, masks=masks, **options)
    return *rest, gradient


def test_a_compiled_program_without_capacity_has_the_bits_of_one_with_it():
    image, alphas, info, gradient = with_medians_and_masks(stacks())
    listed_image, listed_alphas, listed_info, listed_gradient = with_medians_and_masks(stacks(), capacity=2048)
    assert not listed_info["overflowed"] and not info["overflowed"]
    assert int(info["needed"]) == int(listed_info["needed"])
    assert "splats" not in info
    outputs = image, alphas, gradient, info["median_depths"]
    expected = listed_image, listed_alphas, listed_gradient, listed_info["median_depths"]
    jax.tree.map(np.testing.assert_array_equal, outputs, expected)


@pytest.mark.parametrize("scene", [cloud(channels=19), cloud(0)], ids=["two passes", "nothing"])
def test_other_sizes_without_capacity_have_the_bits_of_those_with_it(scene):
    images = jax.jit(lambda s: render(s, backend="native")[:2])(scene)
    jax.tree.map(np.testing.assert_array_equal, images, render(scene, backend="native", capacity=4096)[:2])


def test_a_copy_of_the_package_elsewhere_compiles_nothing(tmp_path):
    """Compiled loops are found by their content, not by where their source lies."""
    shutil.copytree(Path(rasterizer.__file__).parent, tmp_path / "rasterizer")
    before = {file: file.stat().st_mtime_ns for file in compiled.FOLDER.iterdir()}
    program = "import rasterizer._native; print(rasterizer.__file__)"
    command, environment = [sys.executable, "-c", program], {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert Path(done.stdout.strip()).is_relative_to(tmp_path)
    assert done.stderr == ""
    assert before and {file: file.stat().st_mtime_ns for file in compiled.FOLDER.iterdir()} == before
