"""Normals, or depth up to a scale and a shift, of frames from a network that sees one photo at a time."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.io.images import resample
from gsjax.io.normal_maps import resize_normals
from gsjax.networks.records import DepthNetwork, NormalNetwork, decode_normals, is_reliable
from gsjax.networks.runner import Runner, needed_output, output_names, usable
from gsjax.scene import Frame


class NormalEstimator(Runner):
    """Estimates the normals of frames."""

    network: NormalNetwork

    def __init__(self, network: NormalNetwork, weights: str | Path):
        """Load the weights and check them against the record.

        Raises:
            InputError: They cannot be loaded, or do not fit the record.
        """
        super().__init__(network, weights)
        confidence = () if network.confidence is None else (network.confidence,)
        normals, *others = output_names(self.graph, (network.normals, *confidence))
        self._normals = needed_output(self.graph, network.normals, normals, "normals")
        self._confidence = next((name for name in others if name != normals), None)

    def __call__(self, frame: Frame) -> np.ndarray:
        """Return `[H, W, 3]` float32 of the frame's size: unit, in our axes, exactly zero where a normal is unknown.

        A normal is unknown where the network's confidence is too low, and outside the photo's mask or matte.

        Raises:
            InputError: The photo cannot be read, or the graph does not give normals for it.
        """
        pixels, place = frame.pixels(), self.place(frame)
        names = [self._normals] if self._confidence is None else [self._normals, self._confidence]
        outputs = self.outputs(frame, pixels, names)
        raw = self.output_map(outputs[0], 3, place, "normals, three values")
        valid = np.ones(raw.shape[:2], bool)
        if self._confidence is not None and self.network.confidence is not None:
            confidence = self.finite(self.output_map(outputs[1], 1, place, "confidence, one value"), valid, frame)
            valid = is_reliable(self.network.confidence, confidence[..., 0])
        unit = decode_normals(self.network, np.where(valid[..., None], self.finite(raw, valid, frame), 0))
        return resize_normals(unit, frame.width, frame.height) * usable(pixels)[..., None]


class NetworkDepth(NamedTuple):
    """Depth of a frame by a network, at the network's own size."""

    values: np.ndarray  # [h, w] float32, of the record's kind
    valid: np.ndarray  # [h, w] bool, inside the photo's mask and matte
    K: np.ndarray  # [3, 3] float32 the frame's intrinsics at this size


class DepthEstimator(Runner):
    """Estimates the depth of frames."""

    network: DepthNetwork

    def __init__(self, network: DepthNetwork, weights: str | Path):
        """Load the weights and check them against the record.

        Raises:
            InputError: They cannot be loaded, or do not fit the record.
        """
        super().__init__(network, weights)
        (name,) = output_names(self.graph, [network.depth])
        self._depth = needed_output(self.graph, network.depth, name, network.kind)

    def __call__(self, frame: Frame) -> NetworkDepth:
        """Return the depth at the network's size.

        Raises:
            InputError: The photo cannot be read, or the graph does not give one value a pixel for it.
        """
        pixels, place = frame.pixels(), self.place(frame)
        (output,) = self.outputs(frame, pixels, [self._depth])
        values = self.output_map(output, 1, place, f"{self.network.kind}, one value")
        values = self.finite(values, np.ones(values.shape[:2], bool), frame)[..., 0]
        valid = resample(usable(pixels), place.width, place.height).reshape(values.shape) > 0.5
        scale = np.array([place.width / frame.width, place.height / frame.height, 1], np.float32)
        return NetworkDepth(values, valid, frame.K * scale[:, None])
