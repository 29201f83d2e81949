"""Normals of frames from a depth network, whose scale and shift the tracks of structure from motion determine."""

from collections.abc import Sequence
from functools import cached_property

import jax.numpy as jnp
import numpy as np

from gsjax.errors import InputError
from gsjax.io.normal_maps import resize_normals
from gsjax.networks.estimators import DepthEstimator, NetworkDepth
from gsjax.normals.fitted_depth import DepthFit, fit_depth, fitted_depth, normals_of_depth, surface
from gsjax.normals.from_depth import chosen_reduction
from gsjax.scene import Frame, Scene, tracks_by_name
from gsjax.scene.cameras import Camera

VIEWS_FOR_NOISE = 4  # whose fitted depth says how wide the windows of the normals are


class DepthNormals:
    """Makes the normals of a data set's frames, one after the other."""

    def __init__(self, estimator: DepthEstimator, scene: Scene):
        """Reads the tracks.

        Raises:
            InputError: The data set has none.
        """
        self.estimator, self.frames, self.points = estimator, scene.frames, scene.points
        self.tracks = tracks_by_name(scene)
        if not self.tracks:
            raise InputError(
                f"{scene.root}: has no tracks of structure from motion, which tell scale and shift of a depth network"
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
        for frame in _spread(self.frames):
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


def _spread(frames: Sequence[Frame]) -> list[Frame]:
    """Twice `VIEWS_FOR_NOISE` frames, evenly spread: the fit of some may fail."""
    places = np.linspace(0, len(frames) - 1, min(2 * VIEWS_FOR_NOISE, len(frames)))
    return [frames[int(place)] for place in places.round()]
