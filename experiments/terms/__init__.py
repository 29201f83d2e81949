"""Terms of the loss that the library does without: `gsjax.pipeline.train(..., terms=TERMS)`.

Those of SuGaR, which the paper replaces. 2DGS's term is the library's `depth_normal`.
"""

from collections.abc import Mapping

from gsjax.training.terms import Term
from terms import sugar
from terms.surroundings import nearest

__all__ = ["TERMS"]

TERMS: Mapping[str, Term] = {
    "sugar_sdf": Term(sugar.sugar_sdf, {"depth", "gaussians"}, refresh=nearest),
    "sugar_density": Term(sugar.sugar_density, {"gaussians"}, refresh=nearest),
}
