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
    return float(
        np.mean(
            [
                gsjax.psnr(jnp.clip(image, 0, 1), jnp.asarray(view.image, jnp.float32) / 255)
                for image, view in zip(images, views, strict=True)
            ]
        )
    )


@pytest.fixture(scope="module")
def trained(loaded):
    return composed(loaded, WEIGHTS)[0]


def test_it_trains_as_well_as_the_pipeline_at_equal_steps(loaded, scene, trained, tmp_path):
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


def test_a_densification_rule_of_ones_own_decides(loaded):
    rule = gsjax.DENSIFICATION_RULES["error"]._replace(
        wanted_count=lambda gaussians, statistics, density, *, step, budget: jnp.int32(850)
    )
    state, _ = composed(loaded, {"l1": 1.0}, densify=rule, steps=40)
    assert len(state.gaussians.alive()) == 850


def test_the_field_of_a_trained_scene_is_a_normal_map(loaded, trained):
    view = gsjax.read_views(loaded.train_frames[:1], normals=loaded.root / "normals")[0]
    field = gsjax.sdf_gradient(trained.gaussians, view.camera)
    normals = np.asarray(view.normals, np.float32) / 127
    has_both = (np.linalg.norm(field, axis=-1) > 0.5) & (np.linalg.norm(normals, axis=-1) > 0.5)
    cosine = np.abs(np.sum(field * normals, -1))[has_both] / np.linalg.norm(field, axis=-1)[has_both]
    assert np.median(cosine) > np.cos(np.radians(35))


def test_renders_compose_with_jit_grad_and_vmap(loaded, trained):
    gaussians = trained.gaussians
    cameras = [view.camera for view in gsjax.read_views(loaded.train_frames[:2])]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *cameras)

    def image(camera):
        return gsjax.render(gaussians, camera).colors

    images = jax.jit(jax.vmap(image))(batch)
    for one, camera in zip(images, cameras, strict=True):
        np.testing.assert_allclose(one, image(camera), atol=1e-5)

    def brightness(gaussians):
        return jnp.mean(gsjax.render(gaussians, cameras[0]).colors)

    eager, compiled = jax.grad(brightness)(gaussians), jax.jit(jax.grad(brightness))(gaussians)
    np.testing.assert_allclose(eager.sh_dc, compiled.sh_dc, atol=1e-7)


def test_a_mesh_comes_of_the_state(loaded, trained, tmp_path):
    views = gsjax.read_views(loaded.train_frames)
    mesh, report = gsjax.extract_mesh(trained.gaussians, [view.camera for view in views])
    gsjax.write_mesh(tmp_path / "mesh.ply", mesh)
    assert len(gsjax.read_mesh(tmp_path / "mesh.ply").faces) == len(mesh.faces) > 100
    assert report["method"] == "from_level_set"


def test_faults_are_one_line(loaded):
    optimizer = gsjax.adam(loaded.extent, steps=10)
    with pytest.raises(
        gsjax.InputError, match="weights.dsim: no such term of the loss; the nearest known one is 'dssim'"
    ):
        gsjax.train_step(optimizer, {"dsim": 0.2})
    with pytest.raises(ValueError, match="densify='eror' is none of adc, error"):
        gsjax.train_step(optimizer, {"l1": 1.0}, densify="eror")
    with pytest.raises(ValueError, match="background='grey' is none of white, black, random"):
        gsjax.train_step(optimizer, {"l1": 1.0}, background="grey")
    with pytest.raises(ValueError, match="pixel_normal: needs normals, which this view does not have"):
        views = gsjax.read_views(loaded.train_frames[:1])
        gaussians = gsjax.from_points(loaded.points, loaded.point_colors, capacity=BUDGET)
        step = gsjax.train_step(optimizer, {"l1": 1.0, "pixel_normal": 0.1})
        step(gsjax.init(gaussians, optimizer), views[0], jax.random.key(0))
    with pytest.raises(ValueError, match="extent=nan is not a positive number"):
        gsjax.adam(float("nan"), steps=10)
