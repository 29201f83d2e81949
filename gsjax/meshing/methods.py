"""The table of mesh methods. One entry registers a method for `gsjax mesh`, its help, the pipeline and `auto`.

A method's module is loaded where the method is made: help is printed without jax.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from gsjax.errors import InputError
from gsjax.io.machine import require_memory
from gsjax.scene.similarity import Similarity

if TYPE_CHECKING:
    from gsjax.meshing.mesh_method import Method
    from gsjax.meshing.tsdf import NormalsOfDepth
    from gsjax.rendering.coarse_depths import CoarseDepth

MOST_CELLS = 2**16  # along a side; of a surface alone they are tens of gigabytes
BYTES_PER_POINT = 24  # of the surface: place and normal, at the least
FEWEST_TRIED = 20_000  # points of the surface by which `auto` judges a method
AUTO, USUAL = "auto", "poisson"  # the latter where nothing can judge the candidates


@dataclass(frozen=True)
class MethodOptions:
    """The options of all methods; a method reads those that its entry of `METHODS` names. None: it chooses."""

    level: float | None = None  # density at which the surface is
    points: int | None = None  # most points of the surface
    depth: int | None = None  # of the Poisson octree
    trim_quantile: float | None = None  # share of the least supported vertices to cut away
    cell: float | None = None  # side of a voxel, scene units

    def __post_init__(self):
        """Check ranges; raises InputError."""
        if self.level is not None and not 0 < self.level < 1:
            raise InputError(f"level={self.level} is not between 0 and 1")
        if self.trim_quantile is not None and not 0 <= self.trim_quantile < 1:
            raise InputError(f"trim_quantile={self.trim_quantile} is not in 0..1")
        if self.points is not None:
            if self.points < 1:
                raise InputError(f"points={self.points} is below 1")
            require_memory(f"points={self.points}", BYTES_PER_POINT * self.points)
        if self.depth is not None and not 2 <= self.depth <= 14:
            raise InputError(f"depth={self.depth} is not between 2 and 14")
        if self.cell is not None and not 0 < self.cell < math.inf:
            raise InputError(f"cell={self.cell} is not a number above 0")

    @property
    def set_names(self) -> frozenset[str]:
        """The names of the options that are not None."""
        return frozenset(each.name for each in fields(self) if getattr(self, each.name) is not None)

    @property
    def for_comparison(self) -> MethodOptions:
        """The options of a comparison of methods: a tenth of the points, at least `FEWEST_TRIED` if so many exist."""
        assert self.points is not None, "the request has a number of points"
        return replace(self, points=max(self.points // 10, min(self.points, FEWEST_TRIED)))

    def to_local(self, similarity: Similarity, extent: np.ndarray) -> MethodOptions:
        """Return the options with lengths in local coordinates, by world points `[P, 3]` that span what is meshed.

        Raises:
            InputError: The cells are too many.
        """
        if self.cell is None:
            return self
        longest = float(np.ptp(np.quantile(extent, [0.01, 0.99], axis=0), axis=0).max()) if len(extent) else 0.0
        along = longest / self.cell
        if along > MOST_CELLS:
            raise InputError(
                f"cell={self.cell:g}: makes {along:,.0f} cells along the scene's longest side, above {MOST_CELLS:,}"
            )
        return replace(self, cell=similarity.length_to_local(self.cell))


class DepthEvidence(Protocol):
    """What views show and photos imply, computed when a method reads it."""

    normals_of: NormalsOfDepth  # normals of rendered depth, in windows that fit its noise
    rendered: Sequence[CoarseDepth]  # the coarse rendered depth of every view
    stereo: Mapping[int, np.ndarray]  # by the view's index, stereo depth `[h, w]` of its photo; 0 where it is unknown
    stereo_counts: bool  # whether that counts where the rendered depth contradicts it


@dataclass(frozen=True)
class MeshMethod:
    """An entry of the table."""

    summary: str  # a line of the help
    make: Callable[[MethodOptions, DepthEvidence, Sequence[int]], Method]  # the last: indices of the cameras' views
    options: frozenset[str] = frozenset()  # names of the `MethodOptions` that it reads
    needs: frozenset[str] = frozenset()  # "owners" in its pictures, the "photos" of the data set


def _poisson(options: MethodOptions, *_: object) -> Method:
    from gsjax.meshing.level_set import LEVEL, level_set_poisson
    from gsjax.meshing.poisson import at_quantile

    level = LEVEL if options.level is None else options.level
    trim = None if options.trim_quantile is None else at_quantile(options.trim_quantile)
    return level_set_poisson(level=level, most=options.points, depth=options.depth, trim=trim)


def _tsdf(options: MethodOptions, depths: DepthEvidence, ids: Sequence[int]) -> Method:
    from gsjax.meshing.consistent_depth import of_consistent_depth
    from gsjax.meshing.tsdf import tsdf

    return of_consistent_depth(tsdf(depths.normals_of, voxel=options.cell), depths, ids)


METHODS: dict[str, MeshMethod] = {
    "poisson": MeshMethod(
        "Poisson through points of the density's level set",
        _poisson,
        options=frozenset({"points", "depth", "trim_quantile", "level"}),
        needs=frozenset({"owners"}),
    ),
    "tsdf": MeshMethod(
        "fusion of the rendered depth where it is consistent with other views and stereo of the photos, open elsewhere",
        _tsdf,
        options=frozenset({"cell"}),
        needs=frozenset({"photos"}),
    ),
}
"""By name; `auto` tries them in this order."""


def methods_of(method: str | Method, options: MethodOptions) -> dict[str, MeshMethod]:
    """Return the method of a name, or a function of the user under its own name.

    For `auto` these are all methods that read the options that are given.

    Raises:
        InputError: There is no such method, or it does not read an option that is given.
    """
    from gsjax.meshing.mesh_method import method_name

    if callable(method):
        candidates = {method_name(method): MeshMethod("of the user", lambda *_: method, needs=frozenset({"owners"}))}
    elif method == AUTO:
        candidates = {name: each for name, each in METHODS.items() if options.set_names <= each.options}
        if not candidates:
            raise InputError(f"no method reads {' and '.join(sorted(options.set_names))} together")
    elif method in METHODS:
        candidates = {method: METHODS[method]}
    else:
        raise InputError(f"method={method} is none of {', '.join((AUTO, *METHODS))}")
    unread = options.set_names.difference(*(each.options for each in candidates.values()))
    for name in sorted(unread):
        readers = ", ".join(each for each in METHODS if name in METHODS[each].options)
        raise InputError(f"{name} is an option of the method {readers}; {' and '.join(candidates)} does not read it")
    return candidates


def methods_help() -> str:
    """Return a line for every method, and one for the options that it reads."""
    lines = ["methods:"]
    for name, method in METHODS.items():
        lines += [f"  {name}: {method.summary}", f"      {', '.join(map(_flag, sorted(method.options)))}"]
    return "\n".join(lines)


def _flag(option: str) -> str:
    return f"--{option.replace('_', '-')}"
