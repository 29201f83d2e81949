"""Normals of frames, from a network that sees them in a single photo."""

from pathlib import Path

import numpy as np

from gsjax.io.normal_maps import resize_normals
from gsjax.networks.records import NormalNetwork, decode_normals, is_reliable
from gsjax.networks.runner import Runner, needed_output, output_names, usable
from gsjax.scene import Frame


class NormalEstimator(Runner):
    """Estimates the normals of frames."""

    network: NormalNetwork

    def __init__(self, network: NormalNetwork, weights: str | Path):
        """Loads the weights and holds them against the record.

        Raises:
            InputError: They cannot be loaded, or do not fit the record.
        """
        super().__init__(network, weights)
        confidence = () if network.confidence is None else (network.confidence,)
        normals, *others = output_names(self.graph, (network.normals, *confidence))
        self._normals = needed_output(self.graph, network.normals, normals, "normals")
        self._confidence = next((name for name in others if name != normals), None)

    def __call__(self, frame: Frame) -> np.ndarray:
        """`[H, W, 3]` float32 of the frame's size: unit, in our axes, exactly zero where nothing is known.

        Nothing is known where the network's confidence, the photo's mask or its matte says so.

        Raises:
            InputError: The photo cannot be read, or the graph does not give normals for it.
        """
        pixels, place = frame.pixels(), self.place(frame)
        names = [self._normals] if self._confidence is None else [self._normals, self._confidence]
        outputs = self.outputs(frame, pixels, names)
        raw = self.shown(outputs[0], 3, place, "normals, three values")
        known = np.ones(raw.shape[:2], bool)
        if self._confidence is not None and self.network.confidence is not None:
            confidence = self.finite(self.shown(outputs[1], 1, place, "confidence, one value"), known, frame)
            known = is_reliable(self.network.confidence, confidence[..., 0])
        unit = decode_normals(self.network, np.where(known[..., None], self.finite(raw, known, frame), 0))
        return resize_normals(unit, frame.width, frame.height) * usable(pixels)[..., None]
