"""The same run in steps of several views: as many photos seen, in fewer and longer steps."""

import math
from dataclasses import replace

from gsjax.settings import Settings

FIELDS = "means", "means_final", "sh_dc", "sh_rest", "opacities", "scales", "quats"
"""Of the rates, those that are rates."""


def in_larger_steps(settings: Settings) -> Settings:
    """Settings whose steps take `settings.views_per_step` views each, where those given count in views.

    Everything that is counted in steps comes after as many photos as before. The rates grow with the square root of
    the views: Adam divides by the gradient's size, and a mean over V views is nearer to the true one by that root
    (Zhao et al., On Scaling Up 3D Gaussian Splatting Training). What its moments remember is the optimiser's matter
    (`gsjax.training.optimizers.make_optimizer`).
    """
    views = settings.views_per_step
    if views == 1:
        return settings

    def fewer(steps: int) -> int:
        return math.ceil(steps / views)

    density, logging, rates = settings.density, settings.logging, settings.rates
    large_after, decay_steps = density.prune_large_after, rates.decay_steps
    return replace(
        settings,
        phases=tuple(replace(phase, steps=fewer(phase.steps)) for phase in settings.phases),
        sh_every=fewer(settings.sh_every),
        rates=replace(
            rates,
            **{name: math.sqrt(views) * getattr(rates, name) for name in FIELDS},
            decay_steps=None if decay_steps is None else fewer(decay_steps),
        ),
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
