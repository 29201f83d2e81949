"""Which degree a run goes on with, and trials that tell it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud, photographed
from tolerances import assert_close

from gsjax import targets
from gsjax.scene import Pixels, with_pixels
from gsjax.settings import Phase, Rates, Settings, Weights
from gsjax.training import harmonics, trial
from gsjax.training.optimizers import make_optimizer
from gsjax.training.plan import plan
from gsjax.training.state import initial_state

PLAIN = Weights(dssim=0.0)
SETTINGS = Settings(phases=(Phase("vanilla", 2000, PLAIN, density_control=True), Phase("more", 1000, PLAIN)))
PLAN = plan(SETTINGS)
OPTIMIZER = make_optimizer(Rates(), 1.0, 100)
EYES = [(x, y, 0.0) for x in (-2.0, -1.0, 0.0, 1.0, 2.0) for y in (-1.0, 1.0)]
CAMERAS = [camera_at(eye, (0.0, 0.0, 4.0), size=(40, 32), focal=36.0) for eye in EYES]


def scene(strength):
    """Few Gaussians, so that each is in plain view, whose light depends so much on the direction, and is never none."""
    found = cloud(40, sh_degree=2, seed=5)
    rest = found.sh_rest.at[:, 3:].set(0) * strength
    return replace(found, sh_rest=rest, sh_dc=0.4 * found.sh_dc, log_scales=found.log_scales + 0.3)


def noisy(frame):
    """As a sensor would have it: 36 dB."""
    image = frame.pixels().image
    noise = np.random.default_rng(frame.name.encode()[0]).normal(0, 4, image.shape)
    return with_pixels(frame, Pixels(np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)))


@pytest.mark.parametrize(("strength", "degree"), [(0.0, 0), (0.5, 1)])
def test_the_smallest_degree_that_predicts_kept_photos_is_chosen(strength, degree):
    """The bands of the state itself do not matter: it learned them from the photos that are kept from the trial."""
    state = initial_state(replace(scene(strength), sh_rest=cloud(40, sh_degree=2, seed=9).sh_rest), OPTIMIZER)
    before = jax.tree.map(np.asarray, state)
    frames = tuple(map(noisy, photographed(scene(strength), CAMERAS)))
    found = harmonics.score_degrees(PLAN, PLAN.phases[0], frames, state, 1.0, {})
    assert list(found) == [0, 1, 2]
    assert harmonics.smallest_good_degree(found) == degree, found
    jax.tree.map(np.testing.assert_array_equal, before, state)


def test_the_smallest_is_within_the_margin_of_the_best():
    assert harmonics.smallest_good_degree({0: 20.0, 1: 24.95, 2: 25.04, 3: 25.0}) == 1
    assert harmonics.smallest_good_degree({0: 20.0, 1: 20.0}) == 0


def test_what_is_cut_is_nowhere():
    state = initial_state(scene(1.0), OPTIMIZER)
    less = harmonics.cut_bands(state, OPTIMIZER, 1)
    fresh = initial_state(replace(state.gaussians, sh_rest=state.gaussians.sh_rest[:, :3]), OPTIMIZER)
    assert jax.tree.map(jnp.shape, less) == jax.tree.map(jnp.shape, fresh)
    assert less.gaussians.sh_degree == 1
    np.testing.assert_array_equal(less.gaussians.sh_rest, state.gaussians.sh_rest[:, :3])
    np.testing.assert_array_equal(less.gaussians.sh_dc, state.gaussians.sh_dc)
    same = harmonics.cut_bands(state, OPTIMIZER, 2)
    jax.tree.map(np.testing.assert_array_equal, same, state)


@pytest.fixture(scope="module")
def data():
    return targets.with_photo_numbers(targets.read_targets(photographed(scene(1.0), CAMERAS)))


def test_photos_are_kept_whole(data):
    shown, kept = trial.by_photo(data)
    assert [int(t.photo) for t in kept.targets] == [4]
    assert sorted(int(t.photo) for t in (*shown.targets, *kept.targets)) == list(range(10))
    few, last = trial.by_photo(targets.Targets(data.targets[:2]))
    assert [int(t.photo) for t in (*few.targets, *last.targets)] == [0, 1]


def test_every_pixel_is_shown_or_kept_and_every_place_kept_somewhere(data):
    shown, kept = trial.by_block(data)
    for one, other in zip(shown.targets, kept.targets, strict=True):
        assert (one.valid ^ other.valid).all()
    assert np.mean([t.valid.mean() for t in kept.targets]) == pytest.approx(1 / trial.KEPT, abs=0.03)
    assert np.any([t.valid for t in kept.targets], axis=0).all()
    masked = targets.Targets((replace(data.targets[0], valid=np.zeros((32, 40), bool)),))
    assert not any(part.targets[0].valid.any() for part in trial.by_block(masked))


def test_a_trial_scores_before_it_learns(data):
    """No step taken: what is reported is the PSNR of the state as it is."""
    state = initial_state(scene(1.0), OPTIMIZER)
    make = trial.step_factory(SETTINGS, PLAIN, OPTIMIZER, data, effects={}, sh_every=1)
    at = replace(state, step=jnp.asarray(2, jnp.int32))
    end, psnr = trial.run_trial(make, at, data, data, 0, seed=0)
    assert_close(end.gaussians, state.gaussians)
    assert psnr > 45  # Rounding to 255 steps of what the Gaussians themselves show.
