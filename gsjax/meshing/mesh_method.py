"""The signature of a mesh method: it visits every view once, and returns a `SurfaceSamples` that builds the surface.

`gsjax.meshing.methods` is the table of the library's methods; `extract_mesh` takes any function of this signature.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from gsjax import gaussians as gs
from gsjax.gaussians import Gaussians
from gsjax.meshing.regions import Region
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera
from gsjax.scene.meshes import Mesh


class SurfaceSamples(NamedTuple):
    """What a method has gathered from the views."""

    points: np.ndarray  # [P, 3] world: of the surface as it was seen; they say where the regions are
    build: Callable[[Region], tuple[Mesh, dict]]  # the surface in and a little around a region, and plain numbers
    report: dict  # plain numbers


Method = Callable[[Gaussians, Sequence[Camera], Iterable[Picture]], SurfaceSamples]


def method_name(method: Method) -> str:
    """Return the name of a function, or that of the class of another callable."""
    if isinstance(method, partial):
        return method_name(method.func)
    return getattr(method, "__name__", type(method).__name__)


def typical_scale(gaussians: Gaussians, region: Region) -> float:
    """Median of the largest standard deviations of the opaque Gaussians in a region (of all, where there is none)."""
    largest = np.asarray(gs.scales(gaussians)).max(axis=1)
    usable = (np.asarray(gaussians.logit_opacities) > 0) & region.contains(np.asarray(gaussians.means))
    return float(np.median(largest[usable] if usable.any() else largest))
