from pathlib import Path

import pytest

from gsjax.errors import InputError

BENCHMARKS = Path(__file__).resolve().parents[2] / "experiments/benchmarks"


def test_kernels_that_are_wrong_are_not_timed(scripts, monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    rasterizer_gpu = scripts("rasterizer_gpu")
    right = {"image": 1e-3, "means": 1e-5}
    rasterizer_gpu.require_right({"plain": right, "deep": right})
    for wrong in (0.1, float("nan")):
        with pytest.raises(InputError, match=rf"deep, means: {wrong:.2g}\): nothing is timed"):
            rasterizer_gpu.require_right({"plain": right, "deep": {**right, "means": wrong}})
