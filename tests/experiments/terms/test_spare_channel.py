"""Terms that read one more number a Gaussian: at 0 they are the library's own, and what they have no gradient to."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expit
from small_scenes import camera_at, plane
from terms import TERMS
from terms.spare_channel import DOUBT, GAIN, as_geometry, believed, own_opacity, spare, without
from tolerances import assert_close

from gsjax import render
from gsjax.targets import Batch
from gsjax.training.terms.losses import pixel_normal

CAMERA = camera_at(size=(40, 36), focal=36.0)
WALL = plane((0.0, 0.0, -1.0), per_side=12, spacing=0.35, radius=0.3)
BANDS = replace(WALL, sh_rest=jnp.zeros((WALL.num_gaussians, 15, 3), jnp.float32))


def lent(number):
    """The wall whose Gaussians all have this number."""
    first = BANDS.sh_degree**2 - 1
    return replace(BANDS, sh_rest=BANDS.sh_rest.at[:, first, 0].set(number / GAIN))


def tilted(degrees):
    """Maps that say a normal so far off the wall's."""
    turn = np.radians(degrees)
    normals = np.broadcast_to(np.array([np.sin(turn), 0, -np.cos(turn)], np.float32), (36, 40, 3))
    return Batch(CAMERA, None, jnp.ones((36, 40), bool), matte=None, normals=jnp.asarray(normals))


@jax.jit
def losses_and_gradients(gaussians, batch):
    def loss(gaussians, term):
        drawn = replace(gaussians, sh_rest=jnp.zeros_like(gaussians.sh_rest))
        view = render.view(
            drawn, batch.camera, capacity=4096, background=jnp.zeros(3), with_depth=True, depth_mode="front"
        )
        return term(gaussians, view, batch)

    terms = (TERMS["undoubted"].loss, own_opacity, believed, pixel_normal)
    return [jax.value_and_grad(loss)(gaussians, term) for term in terms]


def values(degrees, number=0.0):
    return [float(value) for value, _ in losses_and_gradients(lent(number), tilted(degrees))]


@pytest.mark.parametrize("degrees", [10, 50])
def test_the_terms_have_their_closed_forms_on_a_wall(degrees):
    error = 1 - np.cos(np.radians(degrees))
    undoubted, own, with_confidence, of_library = values(degrees)
    assert_close(undoubted, error, rtol=1e-3, atol=1e-5, why="depth of discs beside each other")
    assert_close(own, undoubted)
    assert_close(with_confidence, expit(2) * undoubted - DOUBT * np.log(expit(2)), rtol=1e-4, atol=1e-6, why="a mean")
    beyond = DOUBT * (1 + np.log(undoubted / DOUBT))
    assert_close(of_library, undoubted if undoubted < DOUBT else beyond, rtol=1e-3, atol=1e-5, why="mean of logarithms")


def test_a_pixel_far_off_is_believed_less_and_one_nearby_more():
    for degrees, sign in ((10, -1), (50, 1)):
        _, (_, gradient), *_ = losses_and_gradients(lent(0.0), tilted(degrees))[1:]
        total = float(jnp.sum(spare(gradient)))
        assert np.sign(total) == sign, "less confidence is downhill where the error is large"


def test_an_opacity_of_its_own_has_the_gradient_and_that_of_colours_has_none():
    _, (_, gradient), *_ = losses_and_gradients(lent(0.5), tilted(30))
    np.testing.assert_array_equal(gradient.logit_opacities, 0)
    assert float(jnp.abs(spare(gradient)).max()) > 0


def test_what_is_drawn_lacks_the_band_and_geometry_has_the_sum():
    gaussians = jax.tree.map(np.asarray, lent(0.7))
    assert without(gaussians).sh_degree == gaussians.sh_degree - 1
    np.testing.assert_array_equal(without(gaussians).sh_rest, gaussians.sh_rest[:, :8])
    assert_close(as_geometry(gaussians).logit_opacities, gaussians.logit_opacities + 0.7)
