"""The densification rules by name (`density.rule`)."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jax import Array

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.rendering import View
from gsjax.scene.batches import Batch
from gsjax.training.densification import error_driven, gradient_driven


class DensificationRule(NamedTuple):
    """What a rule sees of every Gaussian in every view, and what it makes of the sums.

    What it sees is the gradient of the loss to a probe of zeros `[N, 2]`. Statistics are a pytree of `[N]` arrays.
    """

    probes: str  # the argument of `gsjax.rendering` that the probe is
    probe_loss: Callable[[View, Batch], Array | float]  # what is added to the loss for the probe's sake: zero
    empty_statistics: Callable[[int], Any]  # rows -> sums of nothing
    # (sums, gradient, `[N]` visible, `[N]` depths in camera extents, `[2]` size of the photo) -> sums
    accumulate: Callable[[Any, Array, Array, Array, Array], Any]
    wanted_count: Callable[..., Array]  # how many there shall be, see `gradient_driven.wanted_count`
    densify: Callable[..., tuple[Gaussians, gradient_driven.Moves]]  # see `gradient_driven.densify`


DENSIFICATION_RULES: dict[str, DensificationRule] = {
    "adc": DensificationRule(
        "means2d_probe",
        lambda view, batch: 0.0,
        gradient_driven.empty_statistics,
        gradient_driven.accumulate,
        gradient_driven.wanted_count,
        gradient_driven.densify,
    ),
    "error": DensificationRule(
        "probes",
        error_driven.probe_loss,
        error_driven.empty_statistics,
        error_driven.accumulate,
        error_driven.wanted_count,
        error_driven.densify,
    ),
}
"""`adc`: clone and split by the gradient to the 2D mean (3DGS). `error`: by the error that a Gaussian answers for."""


def rule_named(name: str) -> DensificationRule:
    """The rule of a name; InputError where there is none."""
    if name not in DENSIFICATION_RULES:
        raise InputError(f"density.rule={name!r} is none of {', '.join(DENSIFICATION_RULES)}")
    return DENSIFICATION_RULES[name]
