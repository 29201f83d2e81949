"""The loss terms of a refinement: those of the registry whose data it has, and a user's own."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax import rendering
from gsjax.binding.bound import bind
from gsjax.binding.mixed_gaussians import MixedGaussians
from gsjax.errors import InputError
from gsjax.rendering import BoundMesh, View
from gsjax.scene import Frame
from gsjax.scene.batches import Batch
from gsjax.scene.cameras import Camera
from gsjax.scene.meshes import Mesh
from gsjax.training.terms import NEEDS, TERMS, LossTerm, Term, weigh_terms
from gsjax.training.terms.checking import GAUSSIANS, PAIRS, ROWS, TermInputs, as_terms, check_term, shapes_of_step

DATA = frozenset({"depth", "gaussians", "matte", "mesh"})
"""Words of `NEEDS`: what the steps of a refinement have."""


def refinement_terms(
    weights: Mapping[str, float], own: Mapping[str, Term | Callable[..., Array]]
) -> tuple[LossTerm, ...]:
    """The terms of non-zero weight, of the library and of the user, `own`.

    Raises:
        InputError: A weight has no term, or a term needs data that a refinement does not have.
    """
    terms = weigh_terms(weights, {**TERMS, **as_terms(own, _shapes)})
    for each in terms:
        for word in sorted(frozenset(each.term.needs) - DATA):
            raise InputError(f"weights.{each.name}: needs {NEEDS[word]}, which a refinement does not have")
    return terms


def check_terms(terms: Iterable[LossTerm], frames: Sequence[Frame]) -> None:
    """Try the user's terms, and those of the library that read Gaussians of another kind, on the size of the photos.

    Raises:
        InputError: A term reads what it does not need, fails, or is not one float.
    """
    width, height = (max(getattr(frame, side) for frame in frames) for side in ("width", "height"))
    for each in terms:
        if each.term not in TERMS.values() or "gaussians" in each.term.needs:
            check_term(each, _shapes(width, height))


def view_with_mesh(gaussians: MixedGaussians, face_pairs: Array, camera: Camera, **how: Any) -> View:
    """What one view shows, and the mesh with pairs of faces; `how` goes to `gsjax.rendering.render`."""
    view = rendering.render(gaussians, camera, depth_mode="discs", **how)
    return view._replace(mesh=BoundMesh(gaussians.bound.vertices, gaussians.bound.faces, face_pairs))


@lru_cache(maxsize=8)
def _shapes(width: int, height: int) -> TermInputs:
    """All that any term of a refinement may read, as shapes: of as many triangles as free Gaussians."""
    blank = np.zeros((ROWS, 3))
    mesh = Mesh(blank.astype(np.float32), blank.astype(np.int32), blank.astype(np.uint8))
    bound = bind(mesh, per_triangle=1, thickness=1e-6, pixel_filter=GAUSSIANS.pixel_filter)

    def render(gaussians: MixedGaussians, batch: Batch, color: Array) -> View:
        pairs = jnp.zeros((ROWS, 2), jnp.int32)
        return view_with_mesh(gaussians, pairs, batch.camera, capacity=PAIRS, background=color, with_depth=True)

    return shapes_of_step(MixedGaussians(bound, GAUSSIANS), render, width, height)
