"""Terms of the loss that the library does without, handed in as anybody's own: `pipeline.train(..., terms=TERMS)`.

`sdf_central`, `sdf_bicubic` and `sdf_offset` read the paper's gradient otherwise, the `density` terms take the gradient
of the density instead, and the `sugar` terms are those that the paper replaces. `own_opacity` and `believed` train one
more number a Gaussian, and `undoubted` is `pixel_normal` whose pixels all count alike. Tables in experiments/results
show what each of them gives.
"""

from collections.abc import Mapping

import jax
from jax import Array

from gsjax.gaussians import Gaussians
from gsjax.normals.sdf import misalignment, pixel_depth_map
from gsjax.render import MIN_COVERAGE, View
from gsjax.targets import Batch
from gsjax.training.terms import Kept, Term
from gsjax.training.terms.losses import alignment_term
from terms import density, slopes, spare_channel, sugar
from terms.surroundings import nearest

__all__ = ["TERMS"]


def _along_density(estimator) -> Term:
    """R with a gradient of the density, which is summed over the nearest Gaussians."""

    def term(gaussians: Gaussians, view: View, batch: Batch, kept: Kept) -> Array:
        covered = batch.valid & (jax.lax.stop_gradient(view.alphas) > MIN_COVERAGE)
        return misalignment(estimator(gaussians, view, batch.camera, kept), batch.normals, covered)

    return Term(term, {"normals", "gaussians"}, refresh=nearest)


_OF_DEPTH = {"depth", "normals", "gaussians"}
TERMS: Mapping[str, Term] = {
    "sdf_central": Term(alignment_term(slopes.sdf_central_map), _OF_DEPTH),
    "sdf_bicubic": Term(alignment_term(slopes.sdf_bicubic_map), _OF_DEPTH),
    "sdf_offset": Term(alignment_term(slopes.sdf_offset_map), _OF_DEPTH),
    "density_center": _along_density(density.density_center_map),
    "density_offset": _along_density(density.density_offset_map),
    "density_sample": _along_density(density.density_sample_map),
    "own_opacity": Term(spare_channel.own_opacity, _OF_DEPTH),
    "believed": Term(spare_channel.believed, _OF_DEPTH),
    "undoubted": Term(alignment_term(pixel_depth_map), _OF_DEPTH),
    "sugar_sdf": Term(sugar.sugar_sdf, {"depth", "gaussians"}, refresh=nearest),
    "sugar_density": Term(sugar.sugar_density, {"gaussians"}, refresh=nearest),
}
