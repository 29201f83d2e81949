"""Where a scene is and in which units: between the coordinates of a user's files and those that are computed with.

Float32 has seven digits. Of a place at 4,500,000 they leave half a unit, and some limits (the near plane, the smallest
spacing) are numbers of units. So a scene that is far off its origin, or very small or large in its units, is converted
to *local* coordinates as it is read, in float64, and back as it is written. `gsjax.scene.Scene`, Gaussians, meshes,
checkpoints and all that is computed are local; files and reports are in the user's world.

    local = scale * (world - center)

The scale is a power of 4, and the centre a multiple of 32 local units: both are exact in float32, and a scene of usual
size at its origin keeps every number as it is.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gsjax.errors import InputError

if TYPE_CHECKING:  # The vocabulary of scenes loads without jax.
    from gsjax.gaussians import Gaussians
    from gsjax.scene.meshes import Mesh

STEP = 4.0  # A size is brought to 1 or more and less than this, local units.
GRID = 32.0  # Local units between the centres that are chosen from.
FAR_POINTS = 100.0  # Cameras so many times closer together than points are away say nothing of the size.
LOST = 1e-5  # Of a thing's size, the most that float32 may round its coordinates by.
LARGEST_SCALE = 2.0**100  # Of both ways, beside which float32 has room for the places themselves.
FARTHEST = 2.0**60  # Local units from the world's origin: float64 tells places there no longer apart.


@dataclass(frozen=True)
class Similarity:
    """A change of coordinates, by default none."""

    scale: float = 1.0  # local units in one of the world
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)  # world

    @property
    def is_identity(self) -> bool:
        """Whether local coordinates are the world's own."""
        return self == IDENTITY

    @property
    def is_possible(self) -> bool:
        """Whether float64 distinguishes places of the world that local coordinates distinguish."""
        farthest = max(map(abs, self.center)) * self.scale
        return 1 / LARGEST_SCALE <= self.scale <= LARGEST_SCALE and farthest < FARTHEST

    @property
    def summary(self) -> str:
        """The map in words, with all digits."""
        x, y, z = self.center
        return f"local coordinates, {self.scale:.17g} * (world - ({x:.17g}, {y:.17g}, {z:.17g}))"

    def points_to_local(self, points: np.ndarray) -> np.ndarray:
        """`[..., 3]` float32 local positions of world ones."""
        return (self.scale * (np.asarray(points, np.float64) - self.center)).astype(np.float32)

    def points_to_world(self, points: np.ndarray) -> np.ndarray:
        """`[..., 3]` float64 world positions of local ones."""
        return np.asarray(points, np.float64) / self.scale + self.center

    def viewmat_to_local(self, viewmat: np.ndarray) -> np.ndarray:
        """`[4, 4]` float64 local to camera (camera axes in local units too), of world to camera."""
        local = np.array(viewmat, np.float64)
        local[:3, 3] = self.scale * (local[:3, 3] + local[:3, :3] @ self.center)
        return local

    def viewmat_to_world(self, viewmat: np.ndarray) -> np.ndarray:
        """`[4, 4]` float64 world to camera, of local to camera.

        The rotation is made one to the last digit of float64: what float32 leaves of it would move a far centre.
        """
        world = np.array(viewmat, np.float64)
        if self.is_identity:
            return world
        center = self.points_to_world(-world[:3, :3].T @ world[:3, 3])
        left, _, right = np.linalg.svd(world[:3, :3])
        world[:3, :3] = left @ right
        world[:3, 3] = -world[:3, :3] @ center
        return world

    def length_to_local(self, length: Any) -> Any:
        """A length, or an array of them, in local units."""
        return self.scale * length

    def length_to_world(self, length: Any) -> Any:
        """A length, or an array of them, in the world's units."""
        return length / self.scale

    def figures_to_world(self, figures: Mapping[str, Any], lengths: Collection[str]) -> dict[str, Any]:
        """A report, and those within it, with what is named in `lengths` in the world's units; None stays."""

        def in_world(name: str, value: Any) -> Any:
            if isinstance(value, Mapping):
                return self.figures_to_world(value, lengths)
            return self.length_to_world(value) if name in lengths and value is not None else value

        return {name: in_world(name, value) for name, value in figures.items()}

    def gaussians_to_local(self, gaussians: Gaussians) -> Gaussians:
        """Float32 numpy Gaussians of some in the world, whose means may be float64."""
        return self._with_means(gaussians, self.points_to_local(np.asarray(gaussians.means)), math.log(self.scale))

    def gaussians_to_world(self, gaussians: Gaussians) -> Gaussians:
        """The same in the world, numpy; the means are float64 where float32 would lose their place."""
        means = as_needed(self.points_to_world(np.asarray(gaussians.means)))
        return self._with_means(gaussians, means, -math.log(self.scale))

    def mesh_to_local(self, mesh: Mesh) -> Mesh:
        """A mesh with float32 vertices of one in the world, whose vertices may be float64."""
        return replace(mesh, vertices=self.points_to_local(mesh.vertices))

    def mesh_to_world(self, mesh: Mesh) -> Mesh:
        """The same in the world; its vertices are float64 where float32 would lose their place."""
        return replace(mesh, vertices=as_needed(self.points_to_world(mesh.vertices)))

    def _with_means(self, gaussians: Gaussians, means: Any, log_factor: float) -> Gaussians:
        log_scales: Any = np.asarray(gaussians.log_scales) + np.float32(log_factor)
        return replace(gaussians, means=means, log_scales=log_scales)


IDENTITY = Similarity()


def of_cameras(viewmats: np.ndarray, points: np.ndarray) -> Similarity:
    """The similarity of a data set: its cameras, `[V, 4, 4]` float64, are around the local origin, a few units apart.

    Where all photos were taken from one place, its `[P, 3]` float64 points determine the size.
    """
    centers = -np.einsum("vji,vj->vi", viewmats[:, :3, :3], viewmats[:, :3, 3])
    middle = np.median(centers, axis=0)
    return _about(middle, max(spread(centers, middle), spread(points, middle) / FAR_POINTS))


def of_points(points: np.ndarray) -> Similarity:
    """The similarity of Gaussians or of a mesh without cameras, from `[P, 3]` world positions."""
    if not len(points):
        return IDENTITY
    middle = np.median(np.asarray(points, np.float64), axis=0)
    return _about(middle, spread(points, middle))


def is_float32(values: np.ndarray) -> np.ndarray:
    """Whether each float64 value is finite, and still is as float32."""
    return np.abs(values) <= np.finfo(np.float32).max


def loses_in_float32(points: np.ndarray) -> bool:
    """Whether float32 would round `[P, 3]` positions by more than a hundred thousandth of the size of the whole."""
    if points.dtype != np.float64:
        return False
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return False
    middle = np.median(points, axis=0)
    rounding = float(np.abs(middle).max()) * np.finfo(np.float32).eps / 2
    return 0 < LOST * spread(points, middle) < rounding


def as_needed(points: np.ndarray) -> np.ndarray:
    """`[P, 3]` float64 positions as float32, unless that would lose their place."""
    with np.errstate(over="ignore"):
        return points if loses_in_float32(points) else points.astype(np.float32)


def spread(points: np.ndarray, middle: np.ndarray | None = None) -> float:
    """Median distance of `[P, 3]` points from `middle` `[3]`, by default their median; 0 of none."""
    if not len(points):
        return 0.0
    middle = np.median(points, axis=0) if middle is None else middle
    return float(np.median(np.linalg.norm(points - middle, axis=1)))


def parse_similarity(record: Any, file: Path) -> Similarity:
    """The similarity that a JSON file holds, as `dataclasses.asdict` has it.

    Raises:
        InputError: What it holds is none; names the file.
    """
    try:
        x, y, z = (float(number) for number in record["center"])
        similarity = Similarity(float(record["scale"]), (x, y, z))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{file}: holds no similarity of a scale and a center ({str(record)[:80]})") from error
    if not (all(map(math.isfinite, (x, y, z))) and similarity.is_possible):
        raise InputError(f"{file}: a similarity of scale {similarity.scale:g} and center {x:g} {y:g} {z:g} is none")
    return similarity


def _about(middle: np.ndarray, size: float) -> Similarity:
    power = (math.frexp(size)[1] - 1) // 2  # the floor of the logarithm to the base of `STEP`
    scale = STEP**-power if size > 0 else 1.0
    center = np.rint(middle * scale / GRID) * GRID / scale
    return Similarity(scale, tuple((center + 0.0).tolist()))
