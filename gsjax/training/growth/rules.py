"""Who gets the budget of Gaussians: the rules of density control by name (`density.rule`)."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jax import Array

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.rendering import View
from gsjax.scene.batches import Batch
from gsjax.training.growth import adaptive as density_control
from gsjax.training.growth import error_driven


class Rule(NamedTuple):
    """What a rule sees of every Gaussian in every view, and what it makes of the sums.

    What it sees is the gradient of the loss to a probe of zeros `[N, 2]`. Statistics are a pytree of `[N]` arrays.
    """

    probes: str  # the argument of `gsjax.rendering` that the probe is
    probe_loss: Callable[[View, Batch], Array | float]  # what is added to the loss for the probe's sake: zero
    empty_statistics: Callable[[int], Any]  # rows -> sums of nothing
    # (sums, gradient, `[N]` visible, `[N]` depths in camera extents, `[2]` size of the photo) -> sums
    accumulate: Callable[[Any, Array, Array, Array, Array], Any]
    wanted_count: Callable[..., Array]  # how many there shall be, see `density_control.wanted_count`
    densify: Callable[..., tuple[Gaussians, density_control.Moves]]  # see `density_control.densify`


RULES: dict[str, Rule] = {
    "adc": Rule(
        "means2d_probe",
        lambda view, batch: 0.0,
        density_control.empty_statistics,
        density_control.accumulate,
        density_control.wanted_count,
        density_control.densify,
    ),
    "error": Rule(
        "extra",
        error_driven.probe_loss,
        error_driven.empty_statistics,
        error_driven.accumulate,
        error_driven.wanted_count,
        error_driven.densify,
    ),
}
"""`adc`: clone and split by the gradient to the 2D mean (3DGS). `error`: by the error that a Gaussian answers for."""


def rule_named(name: str) -> Rule:
    """The rule of a name.

    Raises:
        InputError: There is none.
    """
    if name not in RULES:
        raise InputError(f"density.rule={name!r} is none of {', '.join(RULES)}")
    return RULES[name]
