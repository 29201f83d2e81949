"""How many harmonics a scene needs: the smallest degree that predicts photos as well as any."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import optax

from gsjax import targets
from gsjax.effects.simulation import Effects
from gsjax.scene import Frame
from gsjax.settings import Rates
from gsjax.training import optimizers, trial
from gsjax.training.plan import Plan, PlannedPhase
from gsjax.training.state import TrainState

MARGIN = 0.1  # dB: so much less than the best is as good
STEPS = 100  # of a trial, of each degree
SHARE = 0.05  # of the run, at most
HURRY = 4.0  # times the rate of the constant band: enough for so few steps
_STILL = 1e-12  # a rate that moves nothing


def score_degrees(
    plan: Plan, phase: PlannedPhase, frames: Sequence[Frame], state: TrainState, extent: float, effects: Effects
) -> dict[int, float]:
    """PSNR of photos that were kept from the colours, by the degree of their harmonics.

    Where Gaussians stand was learned from all photos, and stays. Their colours above the constant band start anew for
    every degree, and are learned from seven of eight photos; the eighth is predicted. What colours by direction make of
    the photos that they were fitted to says nothing.

    Args:
        plan: The run.
        phase: Whose loss and photos.
        frames: The photos that are trained on.
        state: After that phase; left as it is.
        extent: Camera extent, scene units.
        effects: Those that the state has.

    Returns:
        Decibels by degree, 0 to that of the state.
    """
    optimizer = optimizers.make_optimizer(_of_colors(plan.rates), extent, 1)
    steps = max(1, min(STEPS, round(SHARE * plan.steps)))
    # At full size: at half of it splats are blurred otherwise, which colours by direction would learn to make up for.
    shown, kept = trial.by_photo(targets.with_photo_numbers(targets.read_targets(frames, scale=phase.scale)))
    anew = replace(state.gaussians, sh_rest=jnp.zeros_like(state.gaussians.sh_rest))
    begun = replace(state, gaussians=anew, opt_state=optimizer.init(anew), tables={})
    # One program for all: its ramp opens a band every so many steps, and each degree starts where its own are open.
    weights = {each.name: each.weight for each in phase.terms}
    make = trial.step_factory(plan, weights, optimizer, shown, effects=effects, sh_every=steps)

    def psnr(degree: int) -> float:
        at = replace(begun, step=jnp.asarray(degree * steps, jnp.int32))
        return trial.run_trial(make, at, shown, kept, steps, seed=plan.seed)[1]

    return {degree: psnr(degree) for degree in range(state.gaussians.sh_degree + 1)}


def smallest_good_degree(found: dict[int, float]) -> int:
    """The smallest degree within `MARGIN` of the best."""
    return min(degree for degree, psnr in found.items() if psnr >= max(found.values()) - MARGIN)


def _of_colors(rates: Rates) -> Rates:
    """Those of the constant band, in a hurry, for all bands; and of all else what moves nothing."""
    still = dict.fromkeys(("means", "means_final"), _STILL) | dict.fromkeys(("opacities", "scales", "quats"), 0.0)
    return replace(rates, **still, sh_dc=HURRY * rates.sh_dc, sh_rest=HURRY * rates.sh_dc, final_share=1.0)


def cut_bands(state: TrainState, optimizer: optax.GradientTransformation, degree: int) -> TrainState:
    """The state without the bands above a degree: not in the Gaussians, nor in the moments."""
    bands, before = (degree + 1) ** 2 - 1, state.gaussians.sh_rest.shape

    def shorter(array: jax.Array) -> jax.Array:
        return array[:, :bands] if array.shape == before else array

    gaussians = replace(state.gaussians, sh_rest=state.gaussians.sh_rest[:, :bands])
    return replace(state, gaussians=gaussians, opt_state=optimizers.map_moments(optimizer, shorter, state.opt_state))
