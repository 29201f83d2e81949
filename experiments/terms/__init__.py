"""Terms of the loss that the library does without: `gsjax.pipeline.train(..., terms=make_terms(extent))`.

Those of SuGaR, which the paper replaces, and DN-Splatter's. 2DGS's term is the library's `depth_normal`.
"""

from collections.abc import Callable
from pathlib import Path

from gsjax.io.scenes import load_scene
from gsjax.planning.sizes import training_extent
from gsjax.settings import Settings
from gsjax.training.terms import Term
from gsjax.training.terms.losses import alignment_term
from terms import sugar
from terms.surroundings import Surroundings

__all__ = ["make_terms", "terms_of_scene"]


def make_terms(extent: Callable[[], float]) -> dict[str, Term]:
    """The terms of one run by name. SuGaR's two share a table of neighbours.

    Args:
        extent: Of the training cameras, scene units; required where a term of SuGaR is compiled.
    """
    around = Surroundings(extent)
    return {
        "sugar_sdf": Term(around.shown_to(sugar.sugar_sdf), {"depth", "gaussians"}),
        "sugar_density": Term(around.shown_to(sugar.sugar_density), {"gaussians"}),
        "axis_normal": Term(alignment_term(lambda gaussians, view, camera: view.axes), {"axes", "normals"}),
    }


def terms_of_scene(scene: str | Path, settings: Settings) -> dict[str, Term]:
    """The terms of a run on a data set."""

    def extent() -> float:
        split = {"hold_out": settings.photos.hold_out, "photos": settings.photos.subset}
        return training_extent(load_scene(scene, images=settings.photos.images, **split))

    return make_terms(extent)
