"""The terms of the loss of trainings and refinements: the library's by name in `TERMS`; a run's own are arguments.

To add one, write a function of (Gaussians, View, Batch) and say what it needs: `Term(loss, needs)`.
"""

import difflib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from jax import Array
from jaxtyping import Float

from gsjax.errors import InputError
from gsjax.scene.batches import Batches
from gsjax.training.terms import losses, mesh, multi_view

NEEDS = {
    "depth": "the rendered depth, `View.depth`",
    "axes": "the splats' smallest axes composited, `View.axes`",
    "normals": "the normal map of the photo, `Batch.normals`",
    "measured": "measured depth of the photo, `Batch.depth`",
    "neighbor": "a second view, `View.neighbor`",
    "sky": "where the photo shows open sky, `Batch.sky`",
    "matte": "the alpha channel of the photo, `Batch.matte`; without one the term is left out",
    "mesh": "the mesh that the Gaussians are bound to, `View.mesh`",
    "gaussians": "the Gaussians themselves, not their picture alone",
}
"""What a term may need in addition to the image, and where it finds it."""


@dataclass(frozen=True)
class Term:
    """A term of the loss.

    Two terms are the same if their functions are: a function that was edited and run again is compiled again.
    """

    loss: Callable[..., Float[Array, ""]]
    """(Gaussians, `gsjax.rendering.View`, `gsjax.scene.batches.Batch`) -> a mean."""

    needs: Iterable[str] = frozenset()
    """Words of `NEEDS`. What no term needs is neither rendered nor loaded."""

    def __post_init__(self):
        """Check the words."""
        needs = frozenset({self.needs} if isinstance(self.needs, str) else self.needs)
        for word in sorted(needs - NEEDS.keys()):
            raise ValueError(f"needs={word!r} is none of {', '.join(NEEDS)}")
        object.__setattr__(self, "needs", needs)


def align_normals(estimator: Callable[..., Float[Array, "H W 3"]], needs: Iterable[str] = ()) -> Term:
    """The paper's regulariser with an estimator of one's own: mean of 1 - |cos| between its directions and the normals.

    Args:
        estimator: (Gaussians, `gsjax.View` with depth, `gsjax.Camera`) -> directions in the camera's frame, of any
            length; zero where there is none.
        needs: Words of `NEEDS` in addition to depth, normals and the Gaussians.
    """
    return Term(losses.alignment_term(estimator), {"depth", "normals", "gaussians", *needs})


@dataclass(frozen=True)
class LossTerm:
    """A term as a phase has it."""

    name: str
    weight: float
    term: Term

    @property
    def is_surface(self) -> bool:
        """Whether this is a surface term: its steps need more than the image of a view and its Gaussians."""
        return bool(frozenset(self.term.needs) - {"gaussians", "sky", "matte"})


TERMS: Mapping[str, Term] = {
    "l1": Term(losses.l1),
    "dssim": Term(losses.dssim),
    "entropy": Term(losses.entropy, {"gaussians"}),
    "sdf_normal": Term(losses.sdf_normal, {"depth", "normals", "gaussians"}),
    "pixel_normal": Term(losses.pixel_normal, {"depth", "normals"}),
    "thickness": Term(losses.thickness, {"gaussians"}),
    "coverage": Term(losses.coverage, {"normals"}),
    "depth_normal": Term(losses.depth_normal, {"axes", "depth"}),
    "multi_view": Term(multi_view.multi_view, {"depth", "neighbor"}),
    "photometric": Term(multi_view.photometric, {"depth", "neighbor"}),
    "measured_depth": Term(losses.measured_depth, {"depth", "measured"}),
    "alpha": Term(losses.alpha, {"matte"}),
    "sky": Term(losses.sky, {"sky"}),
    "normal_consistency": Term(mesh.normal_consistency, {"mesh"}),
}
"""The library's own, of training and refinement: of the image (3DGS), of the paper (`sdf_normal` is its R), and those
of other mesh makers."""


def weigh_terms(weights: Mapping[str, float], terms: Mapping[str, Term] = TERMS) -> tuple[LossTerm, ...]:
    """The terms of non-zero weight, in the order of `terms`; only these are compiled.

    Raises:
        InputError: A weight is named for which there is no term.
    """
    for name in weights:
        if name not in terms:
            nearest = difflib.get_close_matches(name, terms, n=1, cutoff=0.0)
            hint = f"; the nearest known one is '{nearest[0]}'" if nearest else ""
            raise InputError(f"weights.{name}: no such term of the loss{hint}")
    return tuple(LossTerm(name, weights[name], term) for name, term in terms.items() if weights.get(name, 0.0))


def weights_of_data(need: str, weight: float) -> dict[str, float]:
    """The weights of the library's terms that compare with this data, a word of `NEEDS`: data enable their terms."""
    return {name: weight for name, term in TERMS.items() if need in term.needs}


def comparable_terms(terms: Iterable[LossTerm], data: Batches) -> tuple[LossTerm, ...]:
    """The terms without those that need the mattes that photos lack."""
    return tuple(each for each in terms if data.has_mattes or "matte" not in each.term.needs)


def needs(terms: Iterable[LossTerm]) -> frozenset[str]:
    """All that any of the terms needs, words of `NEEDS`."""
    return frozenset(word for each in terms for word in each.term.needs)
