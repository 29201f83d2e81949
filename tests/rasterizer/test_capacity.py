"""The capacity contract."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import cloud, evaluate, loss, relative_errors, render
from tolerances import assert_close

import rasterizer.api
from rasterizer import capacity_bucket

SCENE = replace(cloud(), scales=2 * cloud().scales)


def test_no_capacity_just_works_under_grad_and_vmap_and_a_batch_is_its_scenes():
    # The second scene needs a fraction of the pairs of the first: the batch takes the larger capacity.
    scenes = [SCENE, replace(SCENE, scales=0.2 * SCENE.scales)]
    gradient_and_rest = jax.grad(partial(loss, backend="native"), has_aux=True)
    gradient, (batch_image, batch_alphas, info) = jax.vmap(gradient_and_rest)(
        jax.tree.map(lambda *x: jnp.stack(x), *scenes)
    )
    assert not info["overflowed"].any()
    for i, scene in enumerate(scenes):
        image, alphas, alone, expected = evaluate(scene, "native")
        assert_close(batch_image[i], image)
        assert_close(batch_alphas[i], alphas)
        assert info["needed"][i] == alone["needed"]
        for name, error in relative_errors(jax.tree.map(lambda x, i=i: x[i], gradient), expected).items():
            assert error < 1e-4, (name, error)


@pytest.mark.parametrize(
    "backend", ["native", *(pytest.param(each, marks=pytest.mark.long) for each in ("xla", "pallas"))]
)
def test_too_small_a_capacity_says_so_and_what_is_needed_and_stays_finite(backend):
    image, _, info, gradient = evaluate(SCENE, backend, capacity=192)
    assert info["overflowed"]
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((image, gradient)))
    needed = int(info["needed"])
    assert needed > 192
    assert not render(SCENE, capacity=capacity_bucket(needed), backend=backend)[2]["overflowed"]


def test_buckets_hold_and_waste_at_most_half():
    for needed in (0, 1, 192, 193, 256, 257, 384, 385, 1000, 1 << 20, (1 << 20) + 1):
        bucket = capacity_bucket(needed)
        assert needed <= bucket <= max(192, 1.5 * needed)
    assert len({capacity_bucket(n) for n in range(1, 100_000, 7)}) < 25
    with pytest.raises(ValueError, match="2147483647 or more"):
        capacity_bucket(2**31 - 1)


def test_a_new_camera_compiles_nothing(monkeypatch):
    image = render(SCENE)[0]
    # What a program calls while it is traced: of the count of pairs, and of the images.
    monkeypatch.setattr(rasterizer.api, "project", None)
    monkeypatch.setattr(rasterizer.api, "_project", None)
    moved = replace(SCENE, viewmats=SCENE.viewmats.at[0, 0, 3].add(1e-3), Ks=SCENE.Ks * 1.0001)
    assert not np.array_equal(render(moved)[0], image)
    with pytest.raises(TypeError, match="not callable"):
        render(replace(SCENE, width=SCENE.width + 1))
