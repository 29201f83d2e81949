"""What is left out of a step, and what the others become: two values of every opacity, with its own as expectation."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from small_scenes import cloud
from tolerances import assert_close

from gsjax.gaussians import opacities
from gsjax.training.dropout import MOST, leave_out
from gsjax.training.initialize import DEAD_LOGIT

ALIVE, DRAWS, SHARE = 40, 2000, 0.3
LOGITS = np.append(np.linspace(-4, 4, ALIVE), np.full(8, DEAD_LOGIT)).astype(np.float32)
GAUSSIANS = replace(cloud(len(LOGITS)), logit_opacities=jnp.asarray(LOGITS))
KEYS = jax.random.split(jax.random.key(0), DRAWS)


def test_an_opacity_is_nothing_or_so_much_more_that_its_expectation_stays():
    samples = np.asarray(jax.vmap(lambda key: opacities(leave_out(GAUSSIANS, SHARE, key)))(KEYS))
    before = np.asarray(opacities(GAUSSIANS))
    denser = np.minimum(before / (1 - SHARE), MOST)
    stays = samples > 1e-9
    assert not stays[:, ALIVE:].any(), "free rows stay free"
    assert_close(samples, np.where(stays, denser, 0))
    deviation = np.sqrt(SHARE * (1 - SHARE) / DRAWS)
    assert np.abs(stays[:, :ALIVE].mean(0) - (1 - SHARE)).max() < 4 * deviation
    assert np.abs(np.corrcoef(stays[:, :ALIVE].T) - np.eye(ALIVE)).max() < 4.5 / np.sqrt(DRAWS), "each by itself"


def test_nothing_but_opacities_changes_and_what_is_left_out_or_full_has_no_gradient():
    sample = leave_out(GAUSSIANS, SHARE, KEYS[0])
    for field in ("means", "quats", "log_scales", "sh_dc", "sh_rest"):
        assert getattr(sample, field) is getattr(GAUSSIANS, field)
    gradient = jax.jit(jax.grad(lambda g: jnp.sum(opacities(leave_out(g, SHARE, KEYS[0])))))(GAUSSIANS)
    before, stays = np.asarray(opacities(GAUSSIANS)), np.asarray(opacities(sample)) > 1e-9
    free = stays & (before < (1 - SHARE) * MOST)
    assert 0 < free.sum() < stays.sum() < ALIVE
    assert_close(gradient.logit_opacities, np.where(free, before * (1 - before) / (1 - SHARE), 0))
