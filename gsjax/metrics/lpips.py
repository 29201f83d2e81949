"""LPIPS: how far apart two pictures look to a network (Zhang et al. 2018), from the network's own features.

With the weights that the user has: an ONNX file of features and of the linear weights over them.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.networks.onnx import Graph

Measure = Callable[[np.ndarray, np.ndarray], float]
"""Two pictures `[H, W, 3]` in 0..1 -> their distance."""

CHANNELS = {
    "vgg": (64, 128, 256, 512, 512),
    "alex": (64, 192, 384, 256, 256),
    "squeeze": (64, 128, 256, 384, 384, 512, 512),
}
"""Channels of the layers whose features are compared, which identify a network."""

STANDARD = "lpips_vgg_3dgs"  # What tables of 3DGS and its kin call LPIPS.
EPSILON = 1e-10  # Beside the length of a feature vector, as in the authors' code.
_TRIAL = 64  # Side of the picture that a file is tried on, pixels.


def lpips_measures(files: Iterable[str | Path]) -> dict[str, Measure]:
    """The measures that files of weights allow, by name.

    `lpips_vgg`, `lpips_alex` and `lpips_squeeze` feed pictures in -1..1, as LPIPS is defined. `lpips_vgg_3dgs` feeds
    them in 0..1, as the code behind the tables of 3DGS does: only it compares with those.

    Args:
        files: One ONNX file each. It takes one picture `[1, 3, H, W]`, RGB in -1..1, of any size, and gives two outputs
            a layer, of which VGG and AlexNet have five and SqueezeNet seven: the features `[1, C, h, w]` of all, then
            their linear weights, of C numbers each.

    Raises:
        InputError: A file is no such graph.
    """
    measures: dict[str, Measure] = {}
    for file in files:
        graph = Graph(file)
        kind = _kind(graph)
        measures[f"lpips_{kind}"] = partial(_distance, graph, lambda picture: 2 * picture - 1)
        if kind == "vgg":
            measures[STANDARD] = partial(_distance, graph, lambda picture: picture)
    return measures


def lpips(first: Sequence[np.ndarray], second: Sequence[np.ndarray], weights: Sequence[np.ndarray]) -> float:
    """Sum over layers of the weighted squared distance between unit feature vectors, averaged over the pixels.

    Args:
        first: Features of one picture, `[C, H, W]` a layer; sizes differ from layer to layer.
        second: Features of the other, of the same shapes.
        weights: `[C]` a layer, not negative.
    """
    total = 0.0
    for one, other, weight in zip(first, second, weights, strict=True):
        distances = np.einsum("c,chw->hw", weight, np.square(_unit(one) - _unit(other)))
        total += float(np.mean(distances, dtype=np.float64))
    return total


def _unit(features: np.ndarray) -> np.ndarray:
    return features / (np.sqrt(np.sum(np.square(features), axis=0)) + EPSILON)


def _distance(graph: Graph, ranged: Callable[[np.ndarray], np.ndarray], image: np.ndarray, target: np.ndarray) -> float:
    (first, weights), (second, _) = (_features(graph, ranged(picture)) for picture in (image, target))
    value = lpips(first, second, weights)
    if not np.isfinite(value):
        raise InputError(f"{graph.file}: gives features that are not finite")
    return value


def _features(graph: Graph, picture: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Features `[C, h, w]` and linear weights `[C]` of every layer, float32."""
    outputs = graph({graph.inputs[0].name: picture.transpose(2, 0, 1)[None]})
    half = len(outputs) // 2
    features = [output[0].astype(np.float32) for output in outputs[:half]]
    return features, [output.reshape(-1).astype(np.float32) for output in outputs[half:]]


def _kind(graph: Graph) -> str:
    """Which network a file holds; tried on a grey picture."""
    shape = graph.inputs[0].shape
    counts = {2 * len(channels) for channels in CHANNELS.values()}
    if len(graph.inputs) != 1 or len(graph.outputs) not in counts or len(shape) != 4 or shape[1] not in (None, 3):
        raise InputError(
            f"{graph.file}: no features for LPIPS; it needs one input [1, 3, H, W] and "
            f"{' or '.join(map(str, sorted(counts)))} outputs, not {len(graph.inputs)} and {len(graph.outputs)}"
        )
    features, weights = _features(graph, np.zeros((_TRIAL, _TRIAL, 3), np.float32))
    for name, channels in CHANNELS.items():
        if tuple(map(len, weights)) == tuple(map(len, features)) == channels and all(f.ndim == 3 for f in features):
            if min(map(np.min, weights)) < 0:
                raise InputError(f"{graph.file}: has negative weights, which LPIPS does not")
            return name
    channel_counts = ", ".join(str(len(each)) for each in [*features, *weights])
    known_channels = "; ".join(f"{name}, {' '.join(map(str, each))} twice" for name, each in CHANNELS.items())
    raise InputError(f"{graph.file}: gives {channel_counts} channels and weights; known are {known_channels}")
