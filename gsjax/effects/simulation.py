"""What training joins where a scene requires an effect: its numbers, their rate, and where it is in a picture.

A step without effects never hears of this: no argument, no state, no operation.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array
from jax.typing import ArrayLike

from gsjax.rendering import View
from gsjax.scene.batches import Batch
from gsjax.scene.cameras import Camera

RATE, FINAL = 2e-3, 1e-2  # Adam's learning rate, and the share of it that is left at the end (PPISP)
HOLD = 300  # steps before an effect may move, and after opacities were reset: colours come first
WARM_UP = 500  # steps to the full rate
LIMIT = 3.0  # of the logarithm of what light is multiplied by: 20 times, on display-coded values
SATURATED = 0.99  # display-coded: a photo that is so bright tells no more than that there was no less light
SHORT = 0.1  # of a run: what both are at most, unless an effect says otherwise


class Effect(NamedTuple):
    """One effect of photography: of its numbers, what it changes on the way from the world to a photo.

    Frozen for a run; what changes is in an `EffectState`. A function that is None is not in the compiled program.
    """

    initial: Any  # pytree of float32: its numbers at step 0
    rate: optax.Schedule  # steps done -> Adam's learning rate; zero holds the numbers still
    camera: Callable[[Any, Camera, Array], Camera] | None = None  # (numbers, as given, which photo) -> where it was
    behind: Callable[[Any, Camera], Array] | None = None  # (numbers, view) -> `[3]` or `[H, W, 3]` behind all Gaussians
    light: Callable[[Any, Array, Batch], Array] | None = None  # (numbers, `[H, W, 3]` before the lens, view) -> photo
    # (numbers, photo as rendered, view) -> `[H, W]` bool pixels that show the scene, `[]` what is added to the loss
    trusts: Callable[[Any, Array, Batch], tuple[Array, Array]] | None = None
    report: Callable[[Any], dict[str, Any]] | None = None  # numbers -> what the run folder has of them, see `reports`


Effects = Mapping[str, Effect]
"""Those that a run simulates, by name."""

NO_EFFECTS: Effects = MappingProxyType({})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EffectState:
    """The numbers of all effects, and of their optimisers."""

    numbers: dict[str, Any]
    moments: dict[str, Any]


def initial_state(effects: Effects) -> EffectState | None:
    """Step 0; None of none, so that nothing of it is stored or compiled."""
    if not effects:
        return None
    numbers = {name: jax.tree.map(jnp.asarray, effect.initial) for name, effect in effects.items()}
    return EffectState(numbers, {name: _adam(effects[name]).init(value) for name, value in numbers.items()})


def reports(effects: Effects, numbers: Mapping[str, Any]) -> dict[str, Any]:
    """What the effects report of their numbers by name: each has some of these, and no other effect has the same.

    `log_gains` and `falloff` of `gsjax.effects.appearance.Appearance` and `moves` of `gsjax.effects.poses.Move`, each
    by the photo's name, and `background`, as `gsjax.rendering.backdrop` has it.
    """
    of_effects = [effect.report(numbers[name]) for name, effect in effects.items() if effect.report]
    return {key: value for each in of_effects for key, value in each.items()}


def move_camera(effects: Effects, numbers: Any, camera: Camera, photo: Array | None) -> Camera:
    """The camera of a photo (`[]` int32) as the effects have it; the given one where there are none.

    Here and below, `numbers` are those of the effects by name, and unused where there are no effects.
    """
    for name, effect in effects.items():
        if effect.camera is not None and photo is not None:
            camera = effect.camera(numbers[name], camera, photo)
    return camera


def light_behind(effects: Effects, numbers: Any, camera: Camera, color: Array) -> Array:
    """`[3]` or `[H, W, 3]` light that comes from no Gaussian; the given `[3]` colour where no effect knows better."""
    for name, effect in effects.items():
        if effect.behind is not None:
            color = effect.behind(numbers[name], camera)
    return color


def light_in_photo(effects: Effects, numbers: Any, colors: Array, batch: Batch) -> Array:
    """`[H, W, 3]` what the camera of a view makes of the light before its lens."""
    for name, effect in effects.items():
        if effect.light is not None:
            colors = effect.light(numbers[name], colors, batch)
    return colors


def photograph(effects: Effects, numbers: Any, view: View, batch: Batch, background: Array) -> View:
    """What the camera makes of a view.

    Where photos have mattes, the background `[3]` is laid under them by us, after any camera: it stays as it is. A
    white pixel says only that there was no less light: what effects make brighter than white there is white.
    """
    if all(effect.light is None for effect in effects.values()):
        return view
    behind = jnp.zeros_like(view.colors)
    if batch.matte is not None:
        behind = (1 - view.alphas)[..., None] * background[None, None]
    colors = light_in_photo(effects, numbers, view.colors - behind, batch) + behind
    # What was brighter than white before any effect stays as wrong as it is without effects.
    most = jnp.maximum(view.colors, 1)
    return view._replace(colors=jnp.where((batch.image > SATURATED) & (colors > most), most, colors))


def mask_untrusted(effects: Effects, numbers: Any, view: View, batch: Batch) -> tuple[Batch, Array | None]:
    """The view with those pixels left out that an effect does not trust, and what it adds to the loss; None of none."""
    added = None
    for name, effect in effects.items():
        if effect.trusts is not None:
            is_trusted, own = effect.trusts(numbers[name], view.colors, batch)
            batch, added = replace(batch, valid=batch.valid & is_trusted), own if added is None else added + own
    return batch, added


def update_effects(effects: Effects, state: EffectState | None, gradients: dict[str, Any] | None) -> EffectState | None:
    """One Adam step of every effect."""
    if state is None or gradients is None:
        return None
    numbers, moments = {}, {}
    # optax mixes int32 counts with floats, which strict promotion forbids.
    with jax.numpy_dtype_promotion("standard"):
        for name, effect in effects.items():
            updates, moments[name] = _adam(effect).update(gradients[name], state.moments[name])
            numbers[name] = optax.apply_updates(state.numbers[name], updates)
    return EffectState(numbers, moments)


def learning_rate(
    steps: int,
    *,
    reset_every: int = 0,
    resets_stop: int = 0,
    peak: float = RATE,
    hold: int = HOLD,
    share: float = SHORT,
    final: float = FINAL,
) -> optax.Schedule:
    """The schedule of a run: zero, a linear warm-up, then log-linear to a share; zero again after every reset.

    A reset of the opacities darkens every render at once, which gains would answer within a few steps.

    Args:
        steps: Of the run.
        reset_every: Steps between resets of the opacities; 0: there are none.
        resets_stop: The last of them.
        peak: What the warm-up leads to.
        hold: Steps that are waited, first and after every reset.
        share: Of the run, what `hold` is at most.
        final: Of the peak, what is left at the end.
    """
    hold = min(hold, max(1, round(share * steps)))
    warm_up = min(WARM_UP, max(1, round(SHORT * steps)))

    def rate(step: ArrayLike) -> Array:
        done = jnp.asarray(step, jnp.float32)
        ramp = jnp.clip((done - hold) / warm_up, 0.0, 1.0)
        value = peak * ramp * final ** (done / steps)
        if not reset_every:
            return value
        too_soon = (done >= reset_every) & (done < resets_stop + hold) & (jnp.mod(done, reset_every) < hold)
        return jnp.where(too_soon, 0.0, value)

    return rate


def _adam(effect: Effect) -> optax.GradientTransformation:
    return optax.adam(effect.rate, eps=1e-15)
