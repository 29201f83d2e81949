"""Depth of frames up to a scale and a shift, from a network that sees it in a single photo."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.io.images import resample
from gsjax.networks.records import DepthNetwork
from gsjax.networks.runner import Runner, needed_output, output_names, usable
from gsjax.scene import Frame


class SeenDepth(NamedTuple):
    """What a network sees of a frame, at the network's own size."""

    values: np.ndarray  # [h, w] float32, of the record's kind
    known: np.ndarray  # [h, w] bool, where the photo shows something that counts
    K: np.ndarray  # [3, 3] float32 the frame's intrinsics at this size


class DepthEstimator(Runner):
    """Estimates the depth of frames."""

    network: DepthNetwork

    def __init__(self, network: DepthNetwork, weights: str | Path):
        """Loads the weights and holds them against the record.

        Raises:
            InputError: They cannot be loaded, or do not fit the record.
        """
        super().__init__(network, weights)
        (found,) = output_names(self.graph, [network.depth])
        self._depth = needed_output(self.graph, network.depth, found, network.kind)

    def __call__(self, frame: Frame) -> SeenDepth:
        """What the network sees.

        Raises:
            InputError: The photo cannot be read, or the graph does not give one value a pixel for it.
        """
        pixels, place = frame.pixels(), self.place(frame)
        (output,) = self.outputs(frame, pixels, [self._depth])
        values = self.shown(output, 1, place, f"{self.network.kind}, one value")
        values = self.finite(values, np.ones(values.shape[:2], bool), frame)[..., 0]
        known = resample(usable(pixels), place.width, place.height).reshape(values.shape) > 0.5
        scale = np.array([place.width / frame.width, place.height / frame.height, 1], np.float32)
        return SeenDepth(values, known, frame.K * scale[:, None])
