"""Which engine "auto" stands for: faked devices, and a jax without Pallas' Triton backend."""

import logging
import subprocess
import sys
from types import SimpleNamespace

import jax
import pytest

from rasterizer import _pallas, devices, engines

H100 = SimpleNamespace(platform="gpu", device_kind="NVIDIA H100 80GB HBM3", compute_capability="9.0")
T4 = SimpleNamespace(platform="gpu", device_kind="Tesla T4", compute_capability="7.5")
AMD = SimpleNamespace(platform="gpu", device_kind="AMD Instinct MI300X", compute_capability="gfx942")
TPU = SimpleNamespace(platform="tpu", device_kind="TPU v5e")


@pytest.fixture
def on(monkeypatch):
    """A function that makes a device jax's default one."""
    engines._log_once.cache_clear()
    return lambda device: monkeypatch.setattr(engines, "default_device", lambda: device)


def test_kernels_run_on_a_gpu_that_they_compile_for(on):
    assert engines.resolve("auto") == "native" and engines.default_tile_size() == 8
    on(H100)
    assert engines.resolve("auto") == "pallas" and engines.default_tile_size() == 16
    assert engines.resolve("xla") == "xla"
    assert not engines._engine("pallas").forward.keywords["interpret"]


@pytest.mark.parametrize(
    ("device", "reason"),
    [
        (T4, "its kernels need compute capability 8.0, and Tesla T4 has 7.5"),
        (AMD, "its kernels are for NVIDIA's GPUs, and this is AMD Instinct MI300X"),
        (TPU, "its kernels are for NVIDIA's GPUs, and this is TPU v5e"),
    ],
)
def test_another_device_takes_jnp_and_one_line_says_why(device, reason, on, caplog):
    on(device)
    with caplog.at_level(logging.WARNING, "rasterizer"):
        assert [engines.resolve("auto") for _ in range(3)] == ["xla"] * 3
        assert engines.default_tile_size() == 8
    assert [record.getMessage() for record in caplog.records] == ["the rasterizer runs in jnp: " + reason]
    if device.platform == "gpu":
        with pytest.raises(ValueError, match=f"backend='pallas': {reason}"):
            engines._engine("pallas")


def test_a_gpu_beside_the_default_device_is_not_asked(monkeypatch):
    """As under `jax.default_device(cpu)` on a machine with a GPU."""
    cpu = jax.devices("cpu")[0]
    monkeypatch.setattr(jax, "local_devices", lambda backend=None: [H100 if backend is None else cpu])
    assert devices.default_device() is H100 and engines.resolve("auto") == "pallas"
    for default in (cpu, "cpu"):
        with jax.default_device(default):
            assert devices.default_device() is cpu and engines.resolve("auto") == "native"


PROGRAM = """
import sys
sys.modules |= dict.fromkeys(["jax.experimental.pallas." + name for name in sys.argv[1:]])
import rasterizer
from rasterizer import _mosaic, _pallas, engines
from types import SimpleNamespace
engines.default_device = lambda: SimpleNamespace(platform="gpu", device_kind="H100", compute_capability="9.0")
chosen = engines.resolve("auto")
print(chosen, engines.resolve("auto"), _pallas.engine(interpret=True).forward.keywords["interpret"])
print(engines._engine(chosen) is _mosaic.engine(interpret=False))
"""


@pytest.mark.parametrize("missing", [["triton"], ["triton", "mosaic_gpu"]], ids=" and ".join)
def test_a_jax_without_triton_imports_and_takes_mosaic_or_jnp(missing):
    """The backend is deprecated since jax 0.11: the day it is gone, nothing but the kernels may go with it."""
    done = subprocess.run([sys.executable, "-c", PROGRAM, *missing], capture_output=True, text=True)
    by_mosaic = missing == ["triton"] and jax.__version_info__ >= devices.LEAST_JAX_OF_MOSAIC
    backend = "pallas" if by_mosaic else "xla"
    assert done.stdout.split() == [backend, backend, "True", str(by_mosaic)], done.stderr
    reason = "the rasterizer runs in jnp: its kernels need Pallas' Triton or Mosaic backend, and jax "
    assert [line.startswith(reason) for line in done.stderr.splitlines()] == [] if by_mosaic else [True]


@pytest.mark.parametrize(
    ("flags", "sums"),
    [
        ("", _pallas.atomic_sums),
        ("--xla_gpu_deterministic_ops=true --xla_a=1", _pallas.sorted_sums),
        ("--xla_gpu_deterministic_ops=false", _pallas.atomic_sums),
    ],
)
def test_the_kernels_sum_in_order_where_xla_is_asked_for_determinism(monkeypatch, flags, sums):
    monkeypatch.setenv("XLA_FLAGS", flags)
    assert engines._engine("pallas").backward.keywords["sum_rows"] is sums
