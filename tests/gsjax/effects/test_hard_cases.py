"""All effects at once on photos that say little or nothing: where they start, values, gradients, and a step of each."""

import json
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from photographed_wall import wall, with_tracks
from small_scenes import cloud

from gsjax import rendering
from gsjax.effects import exposure
from gsjax.effects.diagnosis import diagnose
from gsjax.effects.kinds import simulations
from gsjax.effects.observations import observe
from gsjax.effects.simulation import (
    LIMIT,
    initial_state,
    light_behind,
    mask_untrusted,
    move_camera,
    photograph,
    update_effects,
)
from gsjax.numerics import masked_mean
from gsjax.scene import Pixels, batches, with_pixels
from gsjax.settings import EFFECTS

CLOUD = cloud(60, seed=3)
CLOUD = replace(CLOUD, means=CLOUD.means - jnp.array([[0.0, 0.0, 4.0]]))  # on the wall
BLACK = jnp.zeros(3, jnp.float32)


def repainted(scene, change):
    return replace(scene, frames=tuple(with_pixels(f, change(i, f.pixels())) for i, f in enumerate(scene.frames)))


def flat(value):
    return lambda index, pixels: Pixels(np.full_like(pixels.image, value))


def one_point_each(scene):
    """Every photo has matched one point, and no other photo has."""
    tracks = scene.tracks()
    return with_tracks(scene, [np.flatnonzero((tracks.photo == i) & (tracks.point % 12 == i))[0] for i in range(12)])


def nothing_valid(index, pixels):
    return pixels._replace(valid=np.zeros(pixels.image.shape[:2], np.uint8))


HARD = {
    "ordinary": lambda scene: scene,
    "all photos black": lambda scene: repainted(scene, flat(0)),
    "all photos saturated": lambda scene: repainted(scene, flat(255)),
    "one photo black": lambda scene: repainted(scene, lambda i, p: flat(0)(i, p) if i == 0 else p),
    "tracks of one colour": lambda scene: repainted(scene, flat(128)),
    "nothing but sky": lambda scene: with_tracks(repainted(scene, flat((140, 180, 240))), slice(0)),
    "nothing valid": lambda scene: repainted(scene, nothing_valid),
    "one point a photo": one_point_each,
    "no tracks": lambda scene: replace(scene, tracks=None),
    "one photo": lambda scene: replace(scene, frames=scene.frames[:1]),
    "cameras in one place": lambda scene: replace(
        scene, frames=tuple(replace(f, viewmat=scene.frames[0].viewmat) for f in scene.frames)
    ),
}


def effects_of(scene):
    """All of them, the sky by direction whatever it starts as: one program serves."""
    effects = simulations(observe(scene), EFFECTS, lambda **_: optax.constant_schedule(1e-2))
    sky = effects["background"].initial
    padded = np.concatenate([sky, np.zeros((25 - len(sky), 3), np.float32)])
    return effects | {"background": effects["background"]._replace(initial=padded)}


def objective(effects, numbers, gaussians, batch):
    batch = replace(batch, camera=move_camera(effects, numbers, batch.camera, batch.photo))
    under = light_behind(effects, numbers, batch.camera, BLACK)
    view = rendering.render(gaussians, batch.camera, capacity=16384, background=under)
    view = photograph(effects, numbers, view, batch, BLACK)
    batch, added = mask_untrusted(effects, numbers, view, batch)
    return masked_mean(jnp.mean(jnp.abs(view.colors - batch.image), -1), batch.valid) + added


def program(effects):
    """(numbers, Gaussians, view) -> value, and gradients to the first two."""
    return jax.jit(jax.value_and_grad(partial(objective, effects), (0, 1)))


@pytest.fixture(scope="module")
def of_twelve():
    return program(effects_of(wall()))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] * (name == "cameras in one place")) for name in HARD]
)
def test_values_gradients_and_a_step_are_finite(name, of_twelve):
    scene = HARD[name](wall())
    diagnosis = diagnose(scene)
    assert json.dumps(diagnosis.record(), allow_nan=False)
    # One that differs from all others is blurred; all white and smooth is what a sky looks like; tracks deny one place.
    may_be_on = {"blur", "background"} | ({"poses"} if name == "cameras in one place" else set())
    assert {effect for effect, evidence in diagnosis.effects.items() if evidence.on} <= may_be_on
    effects = effects_of(scene)
    state = initial_state(effects)
    assert set(state.numbers) == {*EFFECTS} - {"sky", "blur"}
    assert np.abs(exposure.log_gains(state.numbers["exposure"])).max() <= LIMIT
    target = batches.with_photo_numbers(batches.read_batches(scene.frames)).views[0]
    target = replace(target, valid=np.ones(target.image.shape[:2], bool) if target.valid is None else target.valid)
    other_gauge = name in ("one photo", "cameras in one place")
    slopes_of = program(effects) if other_gauge else of_twelve
    value, (slopes, of_gaussians) = slopes_of(state.numbers, CLOUD, batches.decode(target, BLACK))
    after = update_effects(effects, state, slopes)
    for leaf in jax.tree.leaves((value, slopes, of_gaussians, after.numbers)):
        assert np.isfinite(leaf).all()
    if name == "nothing valid":
        assert value == 0
        assert not any(np.any(leaf) for leaf in jax.tree.leaves((slopes, of_gaussians)))
    if name == "one photo":
        assert not np.any(slopes["exposure"]) and not np.any(slopes["poses"]["twists"]), "its gauge leaves nothing"
    if name == "ordinary":
        assert all(np.any(leaf) for leaf in jax.tree.leaves(slopes))
