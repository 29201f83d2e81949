"""The GPU kernels without a GPU: interpreted against their twins, and lowered for CUDA."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import cloud, evaluate, relative_errors, stacks
from tolerances import assert_close

from rasterizer import GSPLAT, INRIA, Front, TileGrid, _pallas, engines
from rasterizer.compositing import Static, composite

CASES = {
    "pixels that stop": (stacks(), {}),
    "two cameras, 7 channels": (cloud(cameras=2, channels=7), {}),
    "planes": (cloud(), {"render_mode": "D", "depth_mode": "plane"}),
    "inria": (replace(cloud(), opacities=0.35 * cloud().opacities), {"rules": INRIA}),
}


@pytest.mark.parametrize("name", CASES)
def test_kernels_equal_the_reference(name):
    scene, options = CASES[name]
    if "render_mode" in options:
        scene = replace(scene, backgrounds=scene.backgrounds[:, :1])
    image, alphas, info, gradient = evaluate(scene, "pallas", **options)
    expected_image, expected_alphas, _, expected = evaluate(scene, "reference", **options)
    assert not info["overflowed"]
    assert_close((image, alphas), (expected_image, expected_alphas))
    for field, error in relative_errors(gradient, expected).items():
        assert error < 1e-4, (field, error)


def test_two_runs_give_the_same_bits_and_a_batch_is_its_cameras():
    scene = cloud(cameras=2)
    cameras = {name: getattr(scene, name)[:, None] for name in ("viewmats", "Ks", "backgrounds")}
    both = jax.vmap(lambda camera: evaluate(replace(scene, **camera), "pallas")[:2])(cameras)
    for i in range(2):
        alone = replace(scene, **{name: values[i] for name, values in cameras.items()})
        first, second = evaluate(alone, "pallas"), evaluate(alone, "pallas")
        jax.tree.map(np.testing.assert_array_equal, first, second)
        assert_close((both[0][i], both[1][i]), first[:2])


@pytest.mark.parametrize("backend", ["native", "xla", "pallas"])
def test_a_pair_buffer_that_is_too_short_is_reported_and_stays_finite(backend):
    _, _, info, gradient = evaluate(stacks(), backend, capacity=64)
    assert info["overflowed"]
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


def lowered_for_cuda(program, *arguments):
    """The program's text for a GPU, on a machine without one."""
    traced = jax.jit(program).trace(*arguments)
    if jax.__version_info__ < (0, 11):
        return traced.lower(lowering_platforms=("cuda",)).as_text()
    from jax.sharding import AbstractDevice, AbstractMesh

    h100 = AbstractDevice(device_kind="NVIDIA H100 80GB HBM3", num_cores=132, platform="cuda")
    with jax.sharding.use_abstract_mesh(AbstractMesh((1,), ("x",), abstract_device=h100)):
        return jax.jit(program).trace(*arguments).lower(lowering_platforms=("cuda",)).as_text()


@pytest.mark.parametrize("tile_size, channels", [(8, 1), (16, 3), (32, 16)])
def test_both_kernels_lower_for_cuda(tile_size, channels):
    grid = TileGrid(1, 100, 60, tile_size)
    front = Front(4, 0.2) if channels == 16 else None
    static = Static(grid, GSPLAT, _pallas.engine(interpret=False), with_median=channels == 3, front=front)

    def loss(splats, lists):
        image, left, _ = composite(static, *splats, *lists)
        return jnp.sum(image**2) + jnp.sum(left)

    def array(*shape, dtype=jnp.float32):
        return jax.ShapeDtypeStruct(shape, dtype)

    splats = array(50, 2), array(50, 3), array(50), array(50, channels)
    lists = array(512, dtype=jnp.int32), array(grid.num_tiles + 1, dtype=jnp.int32)
    assert lowered_for_cuda(loss, splats, lists).count("custom_call @__gpu$xla.gpu.triton") == 1
    gradient = jax.grad(loss)
    assert lowered_for_cuda(gradient, splats, lists).count("custom_call @__gpu$xla.gpu.triton") == 2


def test_the_sort_by_tile_is_a_pair_with_a_short_key_on_a_gpu():
    from rasterizer.binning import bin_splats
    from rasterizer.projection import project

    scene = cloud()

    def program(s):
        arrays = s.means, s.quats, s.scales, s.opacities, s.viewmats, s.Ks
        projection = project(*arrays, s.width, s.height)
        return bin_splats(projection, s.opacities, TileGrid(1, s.width, s.height, 16), 512, GSPLAT)

    text = lowered_for_cuda(program, scene)
    # XLA hands these two shapes of sort to CUB: one u64 alone, and an i32 key with its value.
    assert text.count('"stablehlo.sort"') == 2
    assert "(tensor<512xi32>, tensor<512xi32>)" in text and "tensor<40xui64>" in text


def test_the_engine_follows_the_device(monkeypatch):
    assert engines.resolve("auto") == "native" and engines.default_tile_size() == 8
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert engines.resolve("auto") == "pallas" and engines.default_tile_size() == 16
    assert engines.resolve("xla") == "xla"
    monkeypatch.setattr(jax, "default_backend", lambda: "tpu")
    assert engines.resolve("auto") == "xla"


def test_a_tile_that_is_no_power_of_two_is_refused_by_the_kernels_alone():
    with pytest.raises(ValueError, match="tile_size=12 is not a power of two"):
        evaluate(cloud(), "pallas", tile_size=12)
