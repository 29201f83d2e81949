"""Peak memory on a CPU: a million Gaussians at 1920x1080, forward and backward, in a process of their own."""

import json
import os
import subprocess
import sys

import pytest

COUNT, WIDTH, HEIGHT, CAPACITY = 1_000_000, 1920, 1080, 1 << 22

PROGRAM = f"""
import json
import jax, jax.numpy as jnp, numpy as np
import rasterizer
from gsjax.io.machine import peak_memory

rng = np.random.default_rng(0)
focal, depth = 1000.0, rng.uniform(2, 8, {COUNT})
center = np.array([{WIDTH}, {HEIGHT}]) / 2
pixels = rng.uniform(-0.02, 1.02, ({COUNT}, 2)) * 2 * center
means = np.concatenate([(pixels - center) / focal * depth[:, None], depth[:, None]], -1)
scales = rng.lognormal(0, 0.4, ({COUNT}, 3)) * (depth / focal)[:, None]
K = np.array([[focal, 0, center[0]], [0, focal, center[1]], [0, 0, 1]])
arrays = (means, rng.normal(size=({COUNT}, 4)), scales, rng.uniform(0.05, 1, {COUNT}), rng.uniform(size=({COUNT}, 3)))
scene = tuple(jnp.asarray(a, jnp.float32) for a in (*arrays, np.eye(4)[None], K[None]))


def loss(scene):
    image, _, info = rasterizer.rasterization(*scene, {WIDTH}, {HEIGHT}, capacity={CAPACITY}, backend="xla")
    return jnp.sum(image**2), info["overflowed"]


compiled = jax.jit(jax.grad(loss, has_aux=True)).lower(scene).compile()
gradient, overflowed = jax.block_until_ready(compiled(scene))
print(json.dumps({{
    "overflowed": bool(overflowed),
    "finite": all(bool(jnp.isfinite(g).all()) for g in gradient),
    "temporary_bytes": compiled.memory_analysis().temp_size_in_bytes,
    "peak_bytes": peak_memory(),
}}))
"""


@pytest.mark.long
def test_a_million_gaussians_at_full_hd():
    as_users = {**os.environ, "XLA_FLAGS": ""}
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, env=as_users)
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout)
    assert measured["finite"] and not measured["overflowed"]
    assert measured["peak_bytes"] < 6 * 2**30
    # The promise of docs/rasterizer.md: at most 8 floats of workspace per pair, pixel and Gaussian's parameter.
    numbers = CAPACITY + WIDTH * HEIGHT + COUNT * 14
    assert measured["temporary_bytes"] < 8 * 4 * numbers
