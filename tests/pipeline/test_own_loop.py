"""A training loop composed of the public functions, as a notebook would: it trains as well as the pipeline."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gsjax
from gsjax import config
from gsjax.settings import Settings

STEPS, BUDGET, EVERY = 120, 900, 20
WEIGHTS = {"l1": 0.8, "dssim": 0.2, "pixel_normal": 0.05}


@pytest.fixture(scope="module")
def loaded(scene):
    return gsjax.load_scene(scene)


def composed(loaded, losses, *, densify="error", steps=STEPS, **how):
    """The loop of the page *Your own training loop*, and its last metrics."""
    views = gsjax.read_views(loaded.train_frames, normals=loaded.root / "normals")
    gaussians = gsjax.from_points(loaded.points, loaded.point_colors, capacity=BUDGET, sh_degree=1)
    optimizer = gsjax.adam(loaded.extent, steps=STEPS)
    step = gsjax.train_step(optimizer, losses, densify=densify, background="white", **how)
    state, key = gsjax.init(gaussians, optimizer), jax.random.key(0)
    for i, view in zip(range(steps), itertools.cycle(views), strict=False):
        state, metrics = step(state, view, key)
        if densify and i % EVERY == EVERY - 1:
            state = gsjax.densify(state, key)
    return state, metrics


def held_out_psnr(loaded, gaussians):
    views = gsjax.read_views(loaded.held_out_frames)
    images = [gsjax.render(gaussians, view.camera, background=jnp.ones(3)).colors for view in views]
    photos = [jnp.asarray(view.image, jnp.float32) / 255 for view in views]
    scores = [gsjax.psnr(jnp.clip(image, 0, 1), photo) for image, photo in zip(images, photos, strict=True)]
    return float(np.mean(scores))


def test_it_trains_as_well_as_the_pipeline_at_equal_steps(loaded, scene, tmp_path):
    settings = {
        "model": {"background": "white", "depth_mode": "front", "max_gaussians": BUDGET, "sh_degree": 1},
        "photos": {"hold_out": "auto"},
        "schedule": {
            "sh_every": STEPS // 7,
            "phases": [{"name": "only", "steps": STEPS, "weights": WEIGHTS, "density_control": True}],
        },
        "supervision": {"normals": str(scene / "normals")},
        "density": {"rule": "error", "start": 0, "stop": STEPS // 2, "every": EVERY, "full_by": 0.6, "reset_every": 0},
    }
    trained, _ = composed(loaded, WEIGHTS)
    summary = gsjax.train(scene, tmp_path / "run", config.parse(Settings, settings))
    assert held_out_psnr(loaded, trained.gaussians) > summary["psnr"] - 0.2
    assert len(trained.gaussians.alive()) == BUDGET


def test_a_loss_of_ones_own_is_descended_and_an_sdf_estimator_of_ones_own_aligned(loaded):
    def flat(gaussians, view, photo):
        return jnp.mean(gsjax.scales(gaussians).min(-1))

    def towards_camera(gaussians, view, camera):
        return -gsjax.pixel_rays(camera)

    losses = {"l1": 1.0, "flat": (5.0, flat), "facing": (0.1, gsjax.align_normals(towards_camera))}
    _, first = composed(loaded, losses, densify=None, steps=1)
    _, last = composed(loaded, losses, densify=None, steps=22)  # of the same photo
    assert set(first.terms) == {"l1", "flat", "facing"}
    # Adam moves a logarithm by 5e-3 a step at most: to 0.90 of it in 21 steps.
    assert float(last.terms["flat"]) < 0.92 * float(first.terms["flat"])
    assert 0 < float(last.terms["facing"]) < 1
