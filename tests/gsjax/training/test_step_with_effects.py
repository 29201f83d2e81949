"""Effects in the compiled step: absent means absent, present means learned beside the Gaussians."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import step_without_effects
from small_scenes import camera_at, cloud, photographed
from tolerances import assert_close

from gsjax import views
from gsjax.effects import exposure, vignetting
from gsjax.effects.model import learning_rate
from gsjax.settings import Rates, Weights
from gsjax.training.optimizers import make_optimizer
from gsjax.training.rules import RULES
from gsjax.training.state import initial_state
from gsjax.training.step import BACKGROUNDS, make_train_step

CAMERAS = [
    camera_at(eye, (0.0, 0.0, 4.0), size=(32, 32)) for eye in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.3), (0.0, -1.0, 0.0))
]
PHOTOS = Weights(alpha=0.0)
KEY = jax.random.key(0)
OPTIMIZER = make_optimizer(Rates(means=2e-3, means_final=2e-4), 1.0, 60)
ADDRESS = re.compile(r"0x[0-9a-f]+")  # Of functions, in the text of a program.


def options(rule):
    return {"capacity": 8192, "background": BACKGROUNDS["black"], "sh_every": 2, "rule": rule and RULES[rule]}


def start(effects=None, rule="adc"):
    gaussians = cloud(180, capacity=200, seed=1)
    return initial_state(gaussians, OPTIMIZER, RULES[rule], *([effects] if effects else []))


@pytest.fixture(scope="module")
def data():
    return views.numbered(views.views_of(photographed(cloud(200, seed=5), CAMERAS)))


def program(step, state, target) -> str:
    return ADDRESS.sub("", str(jax.make_jaxpr(step)(state, target, KEY)))


@pytest.mark.parametrize(
    ("rule", "weights"), [("adc", PHOTOS), ("error", PHOTOS), (None, Weights(alpha=0.0, entropy=0.1))]
)
def test_a_step_without_effects_is_that_of_a_program_that_never_heard_of_them(rule, weights):
    (target,) = views.views_of(photographed(cloud(200, seed=5), CAMERAS[:1])).targets
    state = start(rule=rule or "adc")
    ours = program(make_train_step(OPTIMIZER, weights, **options(rule)), state, target)
    theirs = program(step_without_effects.make_train_step(OPTIMIZER, weights, **options(rule)), state, target)
    assert ours == theirs


def names(tree) -> set[str]:
    return {jax.tree_util.keystr(path) for path, _ in jax.tree.leaves_with_path(tree)}


def test_what_is_absent_has_no_array():
    assert not [name for name in names(start()) if "effects" in name]
    rate = learning_rate(100)
    only = {"exposure": exposure.simulated(np.zeros((3, 3)), rate)}
    added = names(start(only)) - names(start())
    assert {name for name in added if ".numbers" in name} == {".effects.numbers['exposure']"}
    assert all("vignetting" not in name for name in added)


def test_held_effects_leave_the_others_as_they_were(data):
    """At gains of one, a factor of exactly 1, and a rate of zero: only the order of roundings may differ."""
    rate = learning_rate(3000)
    effects = {
        "exposure": exposure.simulated(np.zeros((3, 3)), rate),
        "vignetting": vignetting.simulated(np.zeros((1, 2)), np.zeros(3), rate),
    }
    step = make_train_step(OPTIMIZER, PHOTOS, **options("adc"), effects=effects)
    plain = make_train_step(OPTIMIZER, PHOTOS, **options("adc"))
    state, without = start(effects), start()
    for target in data.targets:
        state, reported = step(state, target, KEY)
        without, expected = plain(without, views.Target(**{**target.__dict__, "photo": None}), KEY)
    assert_close(reported.loss, expected.loss)
    # Adam divides the rounding of other fusions by a small gradient: 2.3e-6 measured, where steps move 7.5e-3.
    assert_close(state.gaussians.sh_dc, without.gaussians.sh_dc, rtol=1e-4, atol=1e-5, why="other fusions, then Adam")
    assert_close(state.effects.numbers, jax.tree.map(jnp.zeros_like, state.effects.numbers))


@pytest.fixture(scope="module")
def darkened(data):
    """Photos taken by factors, and the compiled step that may learn them at once."""
    true = np.array([[-0.2, 0.0, 0.1], [0.1, 0.1, 0.0], [0.1, -0.1, -0.1]], np.float32)
    targets = []
    for target, gains in zip(data.targets, true, strict=True):
        image = np.rint(np.clip(target.image * np.exp(gains), 0, 255)).astype(np.uint8)
        targets.append(views.Target(**{**target.__dict__, "image": image}))
    effects = {"exposure": exposure.simulated(np.zeros((3, 3)), lambda step: jnp.float32(0.01))}
    return (
        true,
        targets,
        effects,
        make_train_step(OPTIMIZER, Weights(dssim=0.0, alpha=0.0), **options("adc"), effects=effects),
    )


def test_gains_are_learned_from_photos(darkened):
    true, targets, effects, step = darkened
    state = initial_state(cloud(200, seed=5), OPTIMIZER, RULES["adc"], effects)  # The true scene.
    for index in range(120):
        state, _ = step(state, targets[index % 3], KEY)
    found = np.asarray(exposure.log_gains(state.effects.numbers["exposure"]))
    np.testing.assert_allclose(found.mean(0), 0, atol=1e-6)
    assert np.abs(found - true).max() < 0.05


def test_an_overflowed_step_leaves_the_effects_as_they_were(darkened):
    _, targets, effects, _ = darkened
    narrow = make_train_step(OPTIMIZER, PHOTOS, **{**options("adc"), "capacity": 8}, effects=effects)
    state = start(effects)
    before = jax.tree.map(np.asarray, state.effects)
    state, reported = narrow(state, targets[0], KEY)
    assert reported.overflowed
    assert_close(state.effects, before)
