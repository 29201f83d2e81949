"""What is off is absent: a step without effects is the program of a step in which they do nothing."""

import inspect
import re

import jax
import pytest
from small_scenes import camera_at, cloud, photographed

from gsjax.effects import simulation
from gsjax.scene import batches
from gsjax.settings import Rates, Weights
from gsjax.training import step
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.optimizers import make_optimizer
from gsjax.training.state import initial_state
from gsjax.training.step import BACKGROUNDS, make_train_step
from gsjax.training.terms import weigh_terms

OPTIMIZER = make_optimizer(Rates(means=2e-3), 1.0, 200)
ADDRESS = re.compile(r"0x[0-9a-f]+")  # Of functions, in the text of a program.
PHOTOS, ENTROPY = (weigh_terms(Weights(alpha=0.0, entropy=entropy)) for entropy in (0.0, 0.1))
NOTHING = {
    "move_camera": lambda effects, numbers, camera, photo: camera,
    "light_behind": lambda effects, numbers, camera, color: color,
    "photograph": lambda effects, numbers, view, batch, background: view,
    "mask_untrusted": lambda effects, numbers, view, batch: (batch, None),
    "update_effects": lambda effects, state, gradients: None,
}


@pytest.mark.parametrize(("rule", "terms"), [("adc", PHOTOS), ("error", PHOTOS), (None, ENTROPY)])
def test_a_step_without_effects_is_that_in_which_they_do_nothing(rule, terms, monkeypatch):
    """Nor of Gaussians that are left out."""
    called = set(re.findall(r"simulation\.(\w+)\(", inspect.getsource(step)))
    assert called | {"move_camera"} == NOTHING.keys(), "a new function of effects does nothing below"
    camera = camera_at((0.0, 0.0, 0.0), (0.0, 0.0, 4.0), size=(32, 32))
    (target,) = batches.read_batches(photographed(cloud(200, seed=5), [camera])).views
    state = initial_state(cloud(180, capacity=200, seed=1), OPTIMIZER, DENSIFICATION_RULES[rule or "adc"])

    def program() -> str:
        how = {"background": BACKGROUNDS["black"], "rule": rule and DENSIFICATION_RULES[rule], "dropout": 0.0}
        train_step = make_train_step(OPTIMIZER, terms, capacity=8192, sh_every=2, **how)
        return ADDRESS.sub("", str(jax.make_jaxpr(train_step)(state, target, jax.random.key(0))))

    ours = program()
    for name, function in NOTHING.items():
        monkeypatch.setattr(simulation, name, function)
    monkeypatch.setattr(step, "leave_out", None)
    assert ours == program()
