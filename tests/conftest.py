"""One strict session for all tests: CPU, no silent promotion of dtypes."""

import os
from pathlib import Path

os.environ["JAX_PLATFORMS"] = "cpu"

import jax
import pytest

jax.config.update("jax_numpy_dtype_promotion", "strict")

SHARED = Path(__file__).resolve().parents[1] / "../shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of data sets and golden files beside the checkout; skips where there is none."""
    if not SHARED.is_dir():
        pytest.skip("needs the data sets in ../shared, which is not beside this checkout")
    return SHARED.resolve()


@pytest.fixture
def x64():
    """Float64 for the length of one test."""
    with jax.enable_x64(True):
        yield
