"""LPIPS: how far apart two pictures look to a network (Zhang et al. 2018), from the network's own features."""

from collections.abc import Sequence

import numpy as np

EPSILON = 1e-10  # Beside the length of a feature vector, as in the authors' code.


def lpips(first: Sequence[np.ndarray], second: Sequence[np.ndarray], weights: Sequence[np.ndarray]) -> float:
    """Sum over layers of the weighted squared distance between unit feature vectors, averaged over the pixels.

    Args:
        first: Features of one picture, `[C, H, W]` a layer; sizes differ from layer to layer.
        second: Features of the other, of the same shapes.
        weights: `[C]` a layer, not negative.

    Returns:
        0 for equal features; symmetric in the pictures.
    """
    layers = zip(first, second, weights, strict=True)
    return float(sum(np.mean(layer_distance(a, b, w), dtype=np.float64) for a, b, w in layers))


def layer_distance(first: np.ndarray, second: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """`[H, W]` weighted squared distance between the unit feature vectors of a layer, `[C, H, W]` each."""
    return np.einsum("c,chw->hw", weights, np.square(_unit(first) - _unit(second)))


def _unit(features: np.ndarray) -> np.ndarray:
    return features / (np.sqrt(np.sum(np.square(features), axis=0)) + EPSILON)
