"""Gaussians bound to a mesh and free ones beyond it, drawn and trained as one scene."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from gsjax.binding.bound import BoundGaussians, to_gaussians
from gsjax.gaussians import Gaussians, covariances
from gsjax.rendering import Drawable, drawable


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MixedGaussians:
    """G bound and M free Gaussians; wherever both are in one array or file, the bound ones come first.

    Both have the same pixel filter and degree of harmonics: `with_free` sees to it.
    """

    bound: BoundGaussians
    free: Gaussians | None = None  # None: there are none, and nothing of them is in a program

    @property
    def num_gaussians(self) -> int:
        """G + M."""
        return self.bound.num_gaussians + self.num_free

    @property
    def num_free(self) -> int:
        """M."""
        return 0 if self.free is None else self.free.num_gaussians


def with_free(bound: BoundGaussians, free: Gaussians) -> MixedGaussians:
    """Bound and any number of free Gaussians as one scene, on the device.

    The free take on the pixel filter and the degree of harmonics of the bound: bands beyond it are cut, missing ones
    are zero.
    """
    if not free.num_gaussians:
        return MixedGaussians(bound)
    bands = bound.sh_rest.shape[1]
    rest = np.asarray(free.sh_rest)[:, :bands]
    rest = np.pad(rest, ((0, 0), (0, bands - rest.shape[1]), (0, 0)))
    alike = replace(free, sh_rest=rest, pixel_filter=bound.pixel_filter)
    return MixedGaussians(bound, jax.tree.map(jnp.asarray, alike))


@drawable.register
def _(mixed: MixedGaussians) -> Drawable:
    bound = drawable(mixed.bound)
    if mixed.free is None:
        return bound
    free = replace(drawable(mixed.free), quats=None, scales=None, covars=covariances(mixed.free))
    return jax.tree.map(lambda *both: jnp.concatenate(both), bound, free)


def all_gaussians(mixed: MixedGaussians) -> Gaussians:
    """The same Gaussians without their mesh, numpy, see `gsjax.binding.bound.to_gaussians`; then the free ones."""
    bound = to_gaussians(mixed.bound)
    if mixed.free is None:
        return bound
    return jax.tree.map(lambda *both: np.concatenate(both), bound, mixed.free)
