"""LPIPS against the published formula, written out with loops in float64."""

import numpy as np
import pytest
from small_graphs import SmallGraph, small_lpips

from gsjax.errors import InputError
from gsjax.metrics.lpips import lpips, lpips_measures


def published(first, second, weights):
    """sum_l 1 / (H_l W_l) sum_hw w_l . (u_hw - v_hw)^2 with unit feature vectors u, v (Zhang et al. 2018)."""
    total = 0.0
    for a, b, w in zip(first, second, weights, strict=True):
        _, height, width = a.shape
        for i in range(height):
            for j in range(width):
                u, v = a[:, i, j].astype(np.float64), b[:, i, j].astype(np.float64)
                u, v = u / (np.sqrt((u * u).sum()) + 1e-10), v / (np.sqrt((v * v).sum()) + 1e-10)
                total += (w * (u - v) ** 2).sum() / (height * width)
    return total


def random_features(seed, channels=(4, 7), sizes=((6, 5), (3, 2))):
    rng = np.random.default_rng(seed)
    return [np.maximum(rng.normal(size=(c, *s)), 0).astype(np.float32) for c, s in zip(channels, sizes, strict=True)]


WEIGHTS = [np.abs(np.random.default_rng(9).normal(size=c)).astype(np.float32) for c in (4, 7)]


def test_the_published_formula():
    a, b = random_features(0), random_features(1)
    a[0][:, 2, 2] = 0  # No feature at all: the length is zero.
    np.testing.assert_allclose(lpips(a, b, WEIGHTS), published(a, b, WEIGHTS), rtol=1e-6)
    assert lpips(a, a, WEIGHTS) == 0
    assert lpips(a, b, WEIGHTS) == lpips(b, a, WEIGHTS)
    assert lpips(a, [3 * f for f in a], WEIGHTS) < 1e-12, "directions of features, not their lengths"


def pictures():
    rng = np.random.default_rng(3)
    return rng.uniform(size=(2, 33, 40, 3)).astype(np.float32)


def test_the_two_ranges_of_vgg_are_named_apart(tmp_path):
    file, features, weights = small_lpips(tmp_path / "vgg.onnx")
    image, target = pictures()
    measures = lpips_measures([file])
    assert sorted(measures) == ["lpips_vgg", "lpips_vgg_3dgs"]
    as_defined = published(features(2 * image - 1), features(2 * target - 1), weights)
    as_in_3dgs = published(features(image), features(target), weights)
    assert abs(as_defined / as_in_3dgs - 1) > 0.1
    np.testing.assert_allclose(measures["lpips_vgg"](image, target), as_defined, rtol=1e-4)
    np.testing.assert_allclose(measures["lpips_vgg_3dgs"](image, target), as_in_3dgs, rtol=1e-4)
    assert measures["lpips_vgg_3dgs"](image, image) == 0


def test_the_real_squeezenet_knows_equal_pictures_and_how_much_noise_there_is(shared):
    file = shared / "data" / "networks" / "lpips_squeeze_features.onnx"
    if not file.is_file():
        pytest.skip("needs the real network beside the data sets")
    measure = lpips_measures([file])["lpips_squeeze"]
    ramp = np.linspace(0, 1, 64, dtype=np.float32)
    smooth = np.stack(np.broadcast_arrays(ramp[:, None], ramp[None], ramp[:, None] * ramp), axis=-1)
    noise = np.random.default_rng(0).normal(size=smooth.shape).astype(np.float32)
    distances = [measure(np.clip(smooth + level / 255 * noise, 0, 1), smooth) for level in (0, 5, 15, 30)]
    assert distances[0] == 0
    assert all(np.diff(distances) > 0.02), distances


def test_files_that_are_no_such_network_are_named(tmp_path):
    with pytest.raises(InputError, match=r"a.onnx: no such file of weights"):
        lpips_measures([tmp_path / "a.onnx"])
    graph = SmallGraph()
    graph.output(graph.input("in0"), "score")
    with pytest.raises(InputError, match="s.onnx: no features for LPIPS; it needs .* 10 or 14 outputs, not 1 and 1"):
        lpips_measures([graph.save(tmp_path / "s.onnx")])
    with pytest.raises(InputError, match="n.onnx: has negative weights"):
        lpips_measures([small_lpips(tmp_path / "n.onnx", sign=-1.0)[0]])
