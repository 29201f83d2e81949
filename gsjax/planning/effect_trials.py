"""Effects whose evidence lies near its threshold: a short trial with and without each of them decides."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import optax
from tqdm import tqdm

from gsjax.effects.appearance import simulations, start
from gsjax.effects.evidence import Evidence
from gsjax.effects.observations import Observations
from gsjax.effects.simulation import RATE, Effects, EffectState
from gsjax.effects.simulation import initial_state as state_of
from gsjax.scene import Frame
from gsjax.settings import PLAIN
from gsjax.targets import Targets
from gsjax.training import trial
from gsjax.training.optimizers import make_optimizer
from gsjax.training.plan import Plan
from gsjax.training.state import TrainState

NEAR = 1.5  # times the threshold, or that part of it
TRIED = ("exposure", "vignetting", "poses", "background")  # masks choose what they are scored on: no trial tells them
WORTH = 0.1  # dB on what was kept from the trial
STEPS, SHARE = 60, 0.05  # before and after the ways part, each; of the run, at most
FEWEST_STEPS = 4000  # of a run: of a shorter one a trial takes more than a twentieth of the time, and evidence decides
SCORED = 16  # photos whose kept blocks are scored, spread evenly

EffectTrial = Callable[[Observations, Sequence[str], Sequence[str]], dict[str, float]]
"""(photos, effects that are on, effects to be tried) -> decibels that each of the latter brings."""


def is_near(name: str, evidence: Evidence) -> bool:
    """Whether a trial should decide: the statistic is neither plainly over its threshold nor plainly under."""
    value = evidence.value
    return name in TRIED and value is not None and 1 / NEAR < value / evidence.threshold < NEAR


def is_worthwhile(steps: int) -> bool:
    """Whether a run of so many steps is long enough for trials."""
    return steps >= FEWEST_STEPS


def gains(
    plan: Plan,
    frames: Sequence[Frame],
    extent: float,
    initial: Callable[[optax.GradientTransformation, Effects], TrainState],
    seen: Observations,
    on: Sequence[str],
    near: Sequence[str],
) -> dict[str, float]:
    """What each of some effects brings on blocks of pixels that were kept from training, decibels.

    One state is trained with what is on, on small photos and their image alone, without density control; from it, so
    many steps again as it is, and with each of the others. Deterministic, so that the difference is the effect's.

    Args:
        plan: The run.
        frames: The photos that are trained on. Held-out ones play no part.
        extent: Camera extent, scene units.
        initial: (optimiser, effects) -> step 0.
        seen: What the effects start from.
        on: Effects that are simulated anyway.
        near: Effects that are tried.

    Returns:
        PSNR with the effect less that without, by name.
    """
    optimizer = make_optimizer(plan.rates, extent, plan.steps)
    shown, kept = trial.by_block(trial.small_views(frames))
    kept = Targets(kept.targets[:: -(-kept.num_views // SCORED)])
    steps = max(1, min(STEPS, round(SHARE * plan.steps)))

    every = (2 + len(near)) * (steps + kept.num_views)
    bar = tqdm(total=every, desc=f"trying {', '.join(near)}", unit="step", leave=False)

    def steps_with(effects: Effects) -> Callable[[TrainState], tuple[TrainState, float]]:
        make = trial.step_factory(plan, PLAIN, optimizer, shown, effects=effects, sh_every=plan.sh_every)
        return partial(trial.run_trial, make, shown=shown, kept=kept, steps=steps, seed=plan.seed, observe=bar.update)

    def chosen(names: Sequence[str]) -> Effects:
        return simulations(start(seen, names), names, lambda peak=RATE, **_: optax.constant_schedule(peak))

    without = chosen(on)
    go_on = steps_with(without)
    with bar:
        state, _ = go_on(initial(optimizer, without))
        _, least = go_on(state)
        found = {}
        for name in near:
            effects = chosen((*on, name))
            found[name] = steps_with(effects)(replace(state, effects=_joined(state.effects, effects)))[1] - least
    return found


def _joined(before: EffectState | None, effects: Effects) -> EffectState:
    """The state of these effects, of which some were there before."""
    fresh = state_of(effects)
    assert fresh is not None, "one at least is tried"
    if before is None:
        return fresh
    return EffectState(fresh.numbers | before.numbers, fresh.moments | before.moments)
