"""Refinement: a mesh's vertices and the Gaussians bound to it, trained together on the photos (SuGaR, section 4.2).

Towards the end the mesh may be moved once from outside (`refine`, `move_mesh`); then its Gaussians follow it.

Free Gaussians are trained with them as before, but are neither densified nor pruned.
Defaults are SuGaR's at full scale. A shorter run moves its SH ramp and its decay in proportion, unless it sets them, as
the presets of SuGaR's lengths do.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax.binding.bound import LAYOUTS, BoundGaussians
from gsjax.binding.mixed_gaussians import MixedGaussians
from gsjax.binding.refinement_terms import view_with_mesh
from gsjax.config import declare_types
from gsjax.gaussians import PixelFilter
from gsjax.metrics.images import in_decibels
from gsjax.presets import RATES
from gsjax.rendering import backdrop
from gsjax.scene import batches
from gsjax.scene.batches import Batch, Batches
from gsjax.settings import OPACITY_RATE, PLAIN, Rates, Weights, check_lowest, check_seed
from gsjax.training import optimizers
from gsjax.training.capacity import chosen_capacity
from gsjax.training.step import Background, Metrics, guarded_step, weighted_loss
from gsjax.training.stepping import TakeStep, advance, describe_fault
from gsjax.training.terms import LossTerm, comparable_terms, needs
from gsjax.training.terms.mesh import neighboring_faces

WEIGHTS = MappingProxyType({**PLAIN, "normal_consistency": 0.1})
"""Default weights of the loss terms of a refinement."""
VERTICES_FINAL = 1.6e-6  # the vertices' last rate, in the unit of `RefinementRates.vertices` (SuGaR, refine.py)


@dataclass(frozen=True)
class RefinementRates:
    """Adam learning rates, with `OPACITY_RATE`."""

    vertices: float = 1.6e-4  # times 10 extent / sqrt(number of vertices); falls to `VERTICES_FINAL` at `decay_steps`
    decay_steps: int | None = None  # of the vertices; None: twice the steps of the run
    sh_dc: float = 0.0025
    sh_rest: float = 0.000125
    scales: float = 0.005
    rotations: float = 0.001
    final_share: float = 1.0  # of all rates above but the vertices', reached log-linearly in the last third
    free: Rates = Rates()  # of free Gaussians; their `decay_steps` are by default those of the refinement

    def __post_init__(self):
        """Check types and ranges."""
        declare_types(self)
        check_lowest(self, vertices=VERTICES_FINAL, sh_dc=0, sh_rest=0, scales=0, rotations=0)
        if self.decay_steps is not None:
            check_lowest(self, decay_steps=1)
        if not 0 < self.final_share <= 1:
            raise ValueError(f"final_share={self.final_share} is not above 0 and at most 1")


@dataclass(frozen=True)
class Refinement:
    """A refinement run."""

    steps: int = 15_000
    per_triangle: int = 1
    faces: int = 1_000_000  # above it, the mesh is decimated first
    halved_share: float = 0.0  # of `faces`, if it is decimated: come from halving the triangles that most pixels see
    sh_degree: int = 3
    sh_every: int | None = None  # steps after which the next degree joins; None: a fifteenth of them all
    opacity: float = 0.9  # of every Gaussian at the start
    thickness: float = 1e-6  # of the extent: standard deviation along the normal
    pixel_filter: PixelFilter = "mip"  # see `gsjax.rendering.PIXEL_FILTERS`
    keep_free: bool = True  # the run's Gaussians stay where there is no mesh, see `gsjax.binding.uncovered`
    photo_refine_at: float = 1.0  # share of the steps: then photos move the mesh, and it stays there; 1: never
    seed: int = 0
    weights: Mapping[str, float] = Weights(**WEIGHTS)  # of the terms by name; those of `WEIGHTS` need no mention
    rates: RefinementRates = RefinementRates()

    def __post_init__(self):
        """Check types and ranges."""
        declare_types(self)
        object.__setattr__(self, "weights", Weights(**{**WEIGHTS, **self.weights}))
        check_seed(self.seed)
        check_lowest(self, steps=1, faces=1, thickness=0)
        if self.sh_every is not None:
            check_lowest(self, sh_every=1)
        if self.per_triangle not in LAYOUTS:
            raise ValueError(f"per_triangle={self.per_triangle} is none of {', '.join(map(str, LAYOUTS))}")
        if not 0 <= self.sh_degree <= 4:
            raise ValueError(f"sh_degree={self.sh_degree} is not 0 to 4")
        if not 0 < self.opacity < 1 or not self.thickness > 0:
            raise ValueError(f"opacity={self.opacity} is not in 0..1 or thickness={self.thickness} is not above 0")
        if not 0 <= self.halved_share < 1:
            raise ValueError(f"halved_share={self.halved_share} is not at least 0 and below 1")
        if not 0 < self.photo_refine_at <= 1:
            raise ValueError(f"photo_refine_at={self.photo_refine_at} is not above 0 and at most 1")

    @property
    def moving_steps(self) -> int:
        """Steps in which the vertices are trained; the Gaussians are in the rest too."""
        return math.ceil(self.photo_refine_at * self.steps)


PHOTO_REFINE_AT = 0.6  # Before the rates fall: colours have to follow the mesh (docs/meshes.md#refinement).
_FAST = {
    "steps": 1_000,
    "faces": 30_000,
    "halved_share": 0.5,
    "photo_refine_at": PHOTO_REFINE_AT,
    "rates": {
        "vertices": 1.5e-3,
        "sh_dc": 0.005,
        "sh_rest": 2e-3,
        "scales": 0.02,
        "rotations": 0.02,
        "final_share": 0.1,
        "free": RATES,
    },
}
_SUGAR = {"sh_every": 1_000, "rates": {"decay_steps": 30_000}}  # the same at each of its lengths
PRESETS: dict[str, dict[str, Any]] = {
    "fast": _FAST,
    "balanced": {**_FAST, "steps": 2_000, "faces": 60_000},
    "medium": {**_SUGAR, "steps": 7_000},
    "long": {**_SUGAR, "steps": 15_000},
}
"""Two for a CPU, whose few steps are large (docs/meshes.md#refinement), and SuGaR's two that the paper has."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RefineState:
    """All that changes while refining."""

    gaussians: MixedGaussians
    opt_state: Any
    step: Array  # [] int32 steps done


Observe = Callable[[int, RefineState, Metrics, int], None]
"""(steps done, state, metrics, length of the pair buffer) -> None. The next step takes the buffers of the state."""


def refine(
    settings: Refinement,
    terms: Sequence[LossTerm],
    data: Batches,
    state: RefineState,
    optimizer: optimizers.Optimizer,
    *,
    background: Background,
    observe: Observe,
    move_mesh: Callable[[BoundGaussians], BoundGaussians] = lambda bound: bound,
    capacity: int | None = None,
) -> RefineState:
    """Train all parameters of Gaussians and mesh on photos, from `state.step` on.

    Args:
        settings: The run.
        terms: Of the loss, see `gsjax.binding.refinement_terms`. Those that need mattes are left out without mattes.
        data: The photos.
        state: Where to start. Its buffers are taken.
        optimizer: The transformation that made the state.
        background: Under the images; where photos have no mattes it may also be as `gsjax.rendering.backdrop` has it.
        observe: Called after every step.
        move_mesh: Moves the vertices once, after `settings.moving_steps`, if there are more; the remaining steps train
            the Gaussians on them.
        capacity: Pair buffer to continue with; None counts.

    Returns:
        The final state; faces and thickness are as they were.

    Raises:
        InputError: The device has no room, or a loss or a gradient is not finite.
    """
    terms = comparable_terms(terms, data)
    face_pairs = neighboring_faces(np.asarray(state.gaussians.bound.faces))
    how = {"background": background, "sh_every": settings.sh_every or max(settings.steps // 15, 1)}

    def step_of(terms: Sequence[LossTerm], capacity: int) -> TakeStep[RefineState]:
        return partial(make_refine_step(optimizer, terms, capacity=capacity, **how), face_pairs)

    def explain(step: int, state: RefineState, target: Batch, capacity: int) -> str:
        alone = partial(step_of, capacity=capacity)
        return describe_fault(terms, alone, state, target, data, seed=settings.seed, places=[step])

    def after(step: int, state: RefineState, metrics: Metrics, capacity: int) -> RefineState:
        if step == settings.moving_steps < settings.steps:
            state = replace(state, gaussians=replace(state.gaussians, bound=move_mesh(state.gaussians.bound)))
        observe(step, state, metrics, capacity)
        return state

    state, _ = advance(
        partial(step_of, terms),
        after,
        state,
        data,
        (int(state.step), settings.steps),
        seed=settings.seed,
        capacity=capacity or chosen_capacity(state.gaussians, data),
        explain=explain,
    )
    return state


def initial_state(gaussians: MixedGaussians, optimizer: optimizers.Optimizer) -> RefineState:
    """Step 0."""
    return RefineState(gaussians, optimizer.init(with_faces(gaussians, None)), jnp.zeros((), jnp.int32))


def with_faces(gaussians: MixedGaussians, faces: Array | None) -> MixedGaussians:
    """The same Gaussians on these faces; what is trained is everything else, on None."""
    return replace(gaussians, bound=replace(gaussians.bound, faces=faces))


def make_refine_step(
    optimizer: optimizers.Optimizer,
    terms: Sequence[LossTerm],
    *,
    capacity: int,
    background: Background,
    sh_every: int,
) -> Callable[[Array, RefineState, Batch, Array], tuple[RefineState, Metrics]]:
    """The compiled step: (pairs of faces, state, what one view shows, key) -> (state, metrics). The state is donated.

    A view that needs more pairs than `capacity` leaves the state untouched and says so.
    """

    def loss(parameters: MixedGaussians, state: RefineState, face_pairs: Array, batch: Batch, color: Array):
        gaussians = with_faces(parameters, state.gaussians.bound.faces)
        view = view_with_mesh(
            gaussians,
            face_pairs,
            batch.camera,
            capacity=capacity,
            background=backdrop.color_behind(color, batch.camera),
            active_degree=active_degrees(gaussians, state.step // sh_every),
            with_depth="depth" in needs(terms),
        )
        total, losses, error = weighted_loss(terms, None, gaussians, view, batch)
        return total, (losses, error, view.splats.pairs)

    @partial(jax.jit, donate_argnums=1)
    def refine_step(face_pairs: Array, state: RefineState, target: Batch, key: Array):
        def differentiate(state: RefineState, target: Batch, color: Array, key: Array):
            del key
            parameters, batch = with_faces(state.gaussians, None), batches.decode(target, color)
            (total, (losses, error, pairs)), gradients = jax.value_and_grad(loss, has_aux=True)(
                parameters, state, face_pairs, batch, color
            )
            return gradients, Metrics(total, in_decibels(error), pairs.needed, pairs.overflowed, losses), None

        return guarded_step(differentiate, partial(_update, optimizer), background)(state, target, key)

    return refine_step


def _update(
    optimizer: optimizers.Optimizer, state: RefineState, gradients: MixedGaussians, statistics: None, skipped: Array
) -> RefineState:
    del statistics
    parameters = with_faces(state.gaussians, None)
    parameters, opt_state = optimizers.apply_gradients(parameters, state.opt_state, optimizer, gradients, skipped)
    step = jnp.where(skipped, state.step, state.step + 1)
    return RefineState(with_faces(parameters, state.gaussians.bound.faces), opt_state, step)


def active_degrees(gaussians: MixedGaussians, degree: Array) -> Array:
    """The SH degrees of a step, `[]` or one a Gaussian: the ramp is for those that begin, free ones show all theirs."""
    if gaussians.free is None:
        return degree
    full = jnp.full(gaussians.num_free, gaussians.free.sh_degree, degree.dtype)
    return jnp.concatenate([jnp.broadcast_to(degree, gaussians.bound.num_gaussians), full])


def make_optimizer(settings: Refinement, extent: float, num_vertices: int) -> optimizers.Adam:
    """Adam (0.9, 0.999) per field; the vertices' rate falls log-linearly (SuGaR), as that of free means.

    After `settings.moving_steps` it is 0. Others stay, or fall to `settings.rates.final_share` in the last third.
    """
    rates = settings.rates
    of_bound = {
        "log_scales": rates.scales,
        "rotations": rates.rotations,
        "logit_opacities": OPACITY_RATE,
        "sh_dc": rates.sh_dc,
        "sh_rest": rates.sh_rest,
    }
    free = optimizers.make_optimizer(rates.free, extent, rates.free.decay_steps or settings.steps)
    falling = {
        f"bound.{name}": optimizers.falling_at_last(rate, rates.final_share, settings.steps)
        for name, rate in of_bound.items()
    }
    return optimizers.Adam(
        {"bound.vertices": vertex_rate(settings, extent, num_vertices), **falling}
        | {f"free.{name}": rate for name, rate in free.rates.items()}
    )


def vertex_rate(settings: Refinement, extent: float, num_vertices: int) -> optax.Schedule:
    """The vertices' learning rate by the step; 0 after `settings.moving_steps`."""
    rates, unit = settings.rates, 10 * extent / num_vertices**0.5
    falling = optax.exponential_decay(
        rates.vertices * unit,
        rates.decay_steps or 2 * settings.steps,
        VERTICES_FINAL / rates.vertices,
        end_value=VERTICES_FINAL * unit,
    )
    return optax.join_schedules([falling, optax.constant_schedule(0.0)], [settings.moving_steps])
