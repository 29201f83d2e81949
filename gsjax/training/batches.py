"""The same run in steps of several views: as many photos seen, in fewer and longer steps."""

import math
from dataclasses import replace

from gsjax.settings import Rates, Settings


def in_larger_steps(settings: Settings) -> Settings:
    """Settings whose steps take `settings.views_per_step` views each, where those given count in views.

    Everything that is counted in steps comes after as many photos as before. The rates grow with the square root of
    the views: Adam divides by the gradient's size, and a mean over V views is nearer to the true one by that root
    (Zhao et al., On Scaling Up 3D Gaussian Splatting Training; measured in docs/several_devices.md).
    """
    views = settings.views_per_step
    if views == 1:
        return settings

    def fewer(steps: int) -> int:
        return math.ceil(steps / views)

    density, logging = settings.density, settings.logging
    large_after = density.prune_large_after
    return replace(
        settings,
        phases=tuple(replace(phase, steps=fewer(phase.steps)) for phase in settings.phases),
        sh_every=fewer(settings.sh_every),
        rates=_scaled(settings.rates, math.sqrt(views), views),
        density=replace(
            density,
            start=fewer(density.start),
            stop=fewer(density.stop),
            every=fewer(density.every),
            reset_every=fewer(density.reset_every),
            prune_large_after=None if large_after is None else fewer(large_after),
        ),
        logging=replace(
            logging,
            metrics_every=fewer(logging.metrics_every),
            evaluate_every=fewer(logging.evaluate_every),
            checkpoint_every=fewer(logging.checkpoint_every),
        ),
    )


def _scaled(rates: Rates, factor: float, views: int) -> Rates:
    by_field = {name: factor * rate for name, rate in rates.__dict__.items() if name != "decay_steps"}
    return Rates(**by_field, decay_steps=None if rates.decay_steps is None else math.ceil(rates.decay_steps / views))
