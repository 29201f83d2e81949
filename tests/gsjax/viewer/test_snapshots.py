"""What a training hands out: a copy, when asked, and not too often."""

from types import SimpleNamespace

import numpy as np
from small_scenes import cloud

from gsjax.gaussians import opacities
from gsjax.viewer.scenery import browser_splats
from gsjax.viewer.watch import Snapshots


def progress(step, gaussians, effects=None):
    state = SimpleNamespace(gaussians=gaussians, effects=effects)
    return SimpleNamespace(step=step, phase=SimpleNamespace(name="coarse"), state=state)


def test_nothing_is_copied_until_a_page_asks_and_the_copy_outlives_the_buffers_that_the_next_step_takes():
    snapshots, scene = Snapshots(1000, every=5.0, clock=lambda: 10.0), cloud(30)
    expected = np.array(scene.means)
    snapshots.observe(progress(1, None))  # There would be nothing to copy.
    assert snapshots.news() is None
    snapshots.observe(progress(2, scene))
    snapshots.observe(progress(3, None))
    for leaf in (scene.means, scene.quats, scene.log_scales, scene.logit_opacities, scene.sh_dc, scene.sh_rest):
        leaf.delete()
    news = snapshots.news()
    assert news.line == "coarse: step 2 of 1,000"
    np.testing.assert_array_equal(news.gaussians.means, expected)
    assert snapshots.news() is None


def test_a_browser_gets_the_living_in_linear_numbers():
    scene = cloud(30, capacity=48)
    splats = browser_splats(scene)
    assert [part.shape for part in splats.values()] == [(30, 3), (30, 3, 3), (30, 3), (30, 1)]
    np.testing.assert_array_equal(splats["centers"], scene.means[:30])
    np.testing.assert_allclose(splats["opacities"][:, 0], opacities(scene)[:30], rtol=1e-6)
    # The determinant of a covariance is the product of the squared scales, whichever way it is turned.
    product = np.exp(2 * np.asarray(scene.log_scales[:30], np.float64).sum(1))
    np.testing.assert_allclose(np.linalg.det(splats["covariances"].astype(np.float64)), product, rtol=1e-3)
    assert splats["rgbs"].min() >= 0 and splats["rgbs"].max() <= 1
    np.testing.assert_allclose(splats["rgbs"], np.clip(0.5 + 0.28209479 * scene.sh_dc[:30, 0], 0, 1), atol=1e-6)
