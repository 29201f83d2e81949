"""Normals, or depth up to a scale and a shift, of frames from a network that sees one photo at a time."""

from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from gsjax.errors import InputError
from gsjax.io.images import resample
from gsjax.io.normal_maps import resize_normals
from gsjax.networks.records import DepthNetwork, NormalNetwork, decode_normals, is_reliable
from gsjax.networks.runner import Runner, output_names, usable
from gsjax.normals.fitted_depth import DepthFit, fit_depth, fitted_depth, normals_of_depth, surface
from gsjax.normals.from_depth import chosen_reduction
from gsjax.scene import Frame, Scene, tracks_by_name
from gsjax.scene.cameras import Camera

VIEWS_FOR_NOISE = 4  # whose fitted depth says how wide the windows of the normals are


class NormalEstimator(Runner):
    """Estimates the normals of frames."""

    network: NormalNetwork

    def __init__(self, network: NormalNetwork, weights: str | Path):
        """As of `Runner`."""
        super().__init__(network, weights)
        confidence = () if network.confidence is None else (network.confidence,)
        self._normals, others = output_names(self.graph, "normals", network.normals, *confidence)
        self._confidence = next((name for name in others if name != self._normals), None)

    def __call__(self, frame: Frame) -> np.ndarray:
        """Return `[H, W, 3]` float32 of the frame's size: unit, in our axes, exactly zero where a normal is unknown.

        A normal is unknown where the network's confidence is too low, and outside the photo's mask or matte.

        Raises:
            InputError: The photo cannot be read, or the graph does not give normals for it.
        """
        pixels = frame.pixels()
        names = [self._normals] if self._confidence is None else [self._normals, self._confidence]
        outputs = self.outputs(frame, pixels, names)
        raw = self.output_map(outputs[0], 3, frame, "normals, three values")
        valid = np.ones(raw.shape[:2], bool)
        if self._confidence is not None and self.network.confidence is not None:
            confidence = self.finite(self.output_map(outputs[1], 1, frame, "confidence, one value"), frame)
            valid = is_reliable(self.network.confidence, confidence[..., 0])
        unit = decode_normals(self.network, np.where(valid[..., None], self.finite(raw, frame, valid), 0))
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
        """As of `Runner`."""
        super().__init__(network, weights)
        self._depth, _ = output_names(self.graph, network.kind, network.depth)

    def __call__(self, frame: Frame) -> NetworkDepth:
        """Return the depth at the network's size.

        Raises:
            InputError: The photo cannot be read, or the graph does not give one value a pixel for it.
        """
        pixels, place = frame.pixels(), self.place(frame)
        (output,) = self.outputs(frame, pixels, [self._depth])
        values = self.output_map(output, 1, frame, f"{self.network.kind}, one value")
        values = self.finite(values, frame)[..., 0]
        valid = resample(usable(pixels), place.width, place.height).reshape(values.shape) > 0.5
        scale = np.array([place.width / frame.width, place.height / frame.height, 1], np.float32)
        return NetworkDepth(values, valid, frame.K * scale[:, None])


class DepthNormals:
    """Makes the normals of a data set's frames, one after the other."""

    def __init__(self, estimator: DepthEstimator, scene: Scene):
        """Reads the tracks, which determine scale and shift; InputError where the data set has none."""
        self.estimator, self.frames, self.points = estimator, scene.frames, scene.points
        self.tracks = tracks_by_name(scene)
        if not self.tracks:
            raise InputError(
                f"{scene.root}: has no tracks of structure from motion, which set scale and shift of a depth network"
            )

    def __call__(self, frame: Frame) -> tuple[np.ndarray, DepthFit]:
        """`[H, W, 3]` float32 normals of the frame's size, and the fit; all zero where that has a fault.

        A pixel is zero where the photo shows nothing that counts, where the depth has an edge, and where no plane fits.

        Raises:
            InputError: The photo cannot be read, or the graph does not serve it.
        """
        estimate, fit = self._fitted(frame)
        if fit.fault is not None:
            return np.zeros((frame.height, frame.width, 3), np.float32), fit
        normals = normals_of_depth(self._depth(estimate, fit), _camera(frame, estimate), self.reduction)
        return resize_normals(normals, frame.width, frame.height), fit

    @cached_property
    def reduction(self) -> int:
        """The windows of the normals: as wide as the noise of some photos requires, see `chosen_reduction`."""
        views = []
        # Twice as many, evenly spread: the fit of some may fail.
        places = np.linspace(0, len(self.frames) - 1, min(2 * VIEWS_FOR_NOISE, len(self.frames)))
        for frame in (self.frames[int(place)] for place in places.round()):
            estimate, fit = self._fitted(frame)
            if fit.fault is None and len(views) < VIEWS_FOR_NOISE:
                depth, camera = jnp.asarray(self._depth(estimate, fit)), _camera(frame, estimate)
                views.append((depth, surface(depth, camera), camera))
        return chosen_reduction(views)

    def _fitted(self, frame: Frame) -> tuple[NetworkDepth, DepthFit]:
        estimate = self.estimator(frame)
        points, rays = self.tracks.get(frame.name, (np.zeros(0, np.int64), np.zeros((0, 2))))
        depths = self.points[points] @ frame.viewmat[2, :3] + frame.viewmat[2, 3]
        height, width = estimate.values.shape
        x, y = np.floor(rays * estimate.K[[0, 1], [0, 1]] + estimate.K[:2, 2]).astype(int).T
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (depths > 0)
        inside[inside] &= estimate.valid[y[inside], x[inside]]
        return estimate, fit_depth(estimate.values[y[inside], x[inside]], depths[inside], self.estimator.network.kind)

    def _depth(self, estimate: NetworkDepth, fit: DepthFit) -> np.ndarray:
        return fitted_depth(estimate.values, fit, self.estimator.network.kind) * estimate.valid


def _camera(frame: Frame, estimate: NetworkDepth) -> Camera:
    height, width = estimate.values.shape
    return Camera(jnp.asarray(frame.viewmat), jnp.asarray(estimate.K), width, height)
