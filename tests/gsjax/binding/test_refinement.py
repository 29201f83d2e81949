from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import square, turned
from small_scenes import camera_at, cloud
from tolerances import assert_close

from gsjax import config
from gsjax.binding import refinement
from gsjax.binding.bound import bind, to_mesh
from gsjax.binding.mixed_gaussians import MixedGaussians, with_free
from gsjax.binding.refinement import Refinement, RefinementRates
from gsjax.errors import InputError
from gsjax.metrics import geometry
from gsjax.rendering import gallery
from gsjax.scene import Pixels, batches, frame_of
from gsjax.scene.meshes import Mesh
from gsjax.training.step import BACKGROUNDS
from gsjax.training.stepping import view_order
from gsjax.training.terms import weigh_terms

EXTENT, CAPACITY = 4.0, 16384
SETTINGS = Refinement(
    steps=200, sh_degree=0, thickness=2e-3, photo_refine_at=0.8, seed=1, rates=RefinementRates(vertices=1e-3)
)
RAISED = np.array([[0, 0, 1e-3]], np.float32)
EYES = [(0.0, -1.5, 0.0), (1.6, 0.8, 0.5), (-1.6, 0.8, 0.5), (1.2, -1.0, 1.5), (-1.2, -1.0, 1.5), (0.1, 1.7, 0.3)]


def checkered(x, y):
    """Colours that say where they are: two waves, at every scale that 48 pixels show."""
    waves = [np.sin(7 * x) * np.cos(6 * y), np.sin(5 * x + 9 * y), np.cos(8 * x - 4 * y)]
    return np.rint(127.5 + 120 * np.stack(waves, axis=-1)).astype(np.uint8)


def relief(per_side: int, bumps: float) -> Mesh:
    """A wavy sheet about (0, 0, 4), its front towards the camera, painted by place; `bumps` displace its vertices."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(*[np.linspace(-1, 1, per_side)] * 2)
    z = 4 + 0.25 * np.sin(2 * x) * np.cos(2 * y) + bumps * rng.normal(size=x.shape)
    return turned(square(per_side - 1, -1, 1, height=z, color=checkered(x, y).reshape(-1, 3)))


@pytest.fixture(scope="module")
def scene():
    """Photos of the true sheet, and a sheet of the same triangles whose vertices are off."""
    truth, rough = relief(16, 0.0), relief(16, 0.06)
    sharp = bind(truth, per_triangle=6, thickness=2e-3, sh_degree=0, opacity=0.95)
    cameras = [camera_at(eye, (0.0, 0.0, 4.0), size=(48, 48), focal=70.0) for eye in EYES]
    photos = gallery.pictures(sharp, cameras, np.zeros(3))
    frames = tuple(
        frame_of(f"{i}.png", np.asarray(c.viewmat), np.asarray(c.K), Pixels(np.rint(255 * p.colors).astype(np.uint8)))
        for i, (c, p) in enumerate(zip(cameras, photos, strict=True))
    )
    return SimpleNamespace(truth=truth, rough=rough, frames=frames, data=batches.read_batches(frames))


def started(scene, free=None):
    bound = bind(scene.rough, per_triangle=1, thickness=SETTINGS.thickness * EXTENT, sh_degree=0)
    optimizer = refinement.make_optimizer(SETTINGS, EXTENT, scene.rough.num_vertices)
    gaussians = MixedGaussians(bound) if free is None else with_free(bound, free)
    return refinement.initial_state(gaussians, optimizer), optimizer


@pytest.fixture(scope="module")
def whole(scene):
    progress, refined = [], []

    def observe(step, state, metrics, capacity):
        progress.append(SimpleNamespace(state=jax.tree.map(np.array, state), metrics=metrics))

    def raised(bound):
        refined.append(bound)
        return replace(bound, vertices=bound.vertices + RAISED)

    state, optimizer = started(scene)
    how = {"background": BACKGROUNDS["black"], "observe": observe, "move_mesh": raised, "capacity": CAPACITY}
    final = refinement.refine(SETTINGS, weigh_terms(SETTINGS.weights), scene.data, state, optimizer, **how)
    return SimpleNamespace(final=jax.tree.map(np.asarray, final), progress=progress, refined=refined)


def distance(mesh: Mesh, truth: Mesh) -> float:
    a, b = (geometry.sample_surface(each, 4000, seed=0)[0] for each in (mesh, truth))
    return (geometry.nearest(a, b)[0].mean() + geometry.nearest(b, a)[0].mean()) / 2


def test_refinement_brings_the_mesh_to_the_truth(scene, whole):
    mesh = to_mesh(whole.final.gaussians.bound)
    before, after = distance(scene.rough, scene.truth), distance(mesh, scene.truth)
    off = [np.abs(m.vertices - scene.truth.vertices)[:, 2].mean() for m in (scene.rough, mesh)]
    assert after < 0.6 * before
    assert off[1] < 0.3 * off[0]
    first, last = (np.mean([p.metrics.psnr for p in part]) for part in (whole.progress[:6], whole.progress[-6:]))
    assert last > first + 8  # decibels
    np.testing.assert_array_equal(mesh.faces, scene.rough.faces)


def test_the_mesh_is_moved_once_and_then_its_gaussians_alone_are_trained(whole):
    bounds = [p.state.gaussians.bound for p in whole.progress]
    moving = SETTINGS.moving_steps
    assert (len(bounds), moving, len(whole.refined)) == (200, 160, 1)
    before, after, last = bounds[moving - 2], bounds[moving - 1], bounds[-1]
    np.testing.assert_array_equal(last.vertices, after.vertices)
    assert_close(
        np.median(after.vertices - before.vertices, axis=0), RAISED[0], atol=2e-4, why="one more step at a falling rate"
    )
    for name in ("log_scales", "rotations", "logit_opacities", "sh_dc"):
        assert np.abs(getattr(last, name) - getattr(after, name)).max() > 1e-4, name


def test_the_loss_is_the_weighted_sum_of_its_terms(whole):
    first = whole.progress[0].metrics
    assert set(first.terms) == {"l1", "dssim", "normal_consistency"}  # no mattes, no alpha term
    total = 0.8 * first.terms["l1"] + 0.2 * first.terms["dssim"] + 0.1 * first.terms["normal_consistency"]
    assert_close(first.loss, total)


def test_the_ramp_of_the_harmonics_is_for_those_that_begin(scene):
    gaussians = started(scene, cloud(3, sh_degree=0))[0].gaussians
    gaussians = replace(gaussians, free=replace(gaussians.free, sh_rest=jnp.zeros((3, 15, 3), jnp.float32)))
    degrees = refinement.active_degrees(gaussians, jnp.int32(1))
    np.testing.assert_array_equal(degrees, [1] * gaussians.bound.num_gaussians + [3] * 3)
    assert refinement.active_degrees(MixedGaussians(gaussians.bound), jnp.int32(1)).shape == ()


def test_the_rates_are_those_of_the_mesh_and_of_training():
    mesh = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8))
    gaussians = with_free(bind(mesh, per_triangle=1, thickness=1e-3), cloud(2, sh_degree=3))
    optimizer = refinement.make_optimizer(Refinement(steps=500), 2.0, 400)
    parameters = refinement.with_faces(gaussians, None)
    ones = jax.tree.map(jnp.ones_like, parameters)
    with jax.numpy_dtype_promotion("standard"):
        updates, _ = jax.jit(optimizer.update)(ones, jax.jit(optimizer.init)(parameters), parameters)
    # Adam's first step is the rate itself; for the vertices 1.6e-4 times 10 extent / sqrt(V).
    assert_close(updates.bound.vertices, np.full((3, 3), -Refinement().rates.vertices * 10 * 2.0 / 20))
    assert_close(updates.bound.rotations, np.full((1, 2), -1e-3))
    assert_close(updates.bound.log_scales, np.full((1, 2), -5e-3))
    rates = {"means": 2.0 * 1.6e-4, "quats": 1e-3, "log_scales": 5e-3, "logit_opacities": 0.05, "sh_dc": 2.5e-3}
    for name, rate in {**rates, "sh_rest": 1.25e-4}.items():
        update = getattr(updates.free, name)
        assert_close(update, np.full(update.shape, -rate))
    falling = refinement.make_optimizer(Refinement(steps=6, rates=RefinementRates(final_share=0.1)), 2.0, 400).rates
    rotations = [float(falling["bound.rotations"](step)) for step in range(6)]
    np.testing.assert_allclose(rotations, 1e-3 * 0.1 ** (np.array([0, 0, 0, 0, 0, 1]) / 2), rtol=1e-3)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"steps": 0}, "steps=0 is below 1"),
        ({"per_triangle": 2}, "per_triangle=2 is none of 1, 3, 4, 6"),
        ({"sh_degree": 5}, "sh_degree=5 is not 0 to 4"),
        ({"opacity": 1.0}, "opacity=1.0"),
        ({"thickness": 0.0}, "thickness=0.0"),
        ({"halved_share": 1.0}, "halved_share=1.0 is not at least 0 and below 1"),
        ({"photo_refine_at": 0.0}, "photo_refine_at=0.0 is not above 0 and at most 1"),
        ({"rates": {"vertices": 0.0}}, "rates: vertices=0.0 is below 1.6e-06"),
        ({"rates": {"final_share": 0.0}}, "rates: final_share=0.0 is not above 0 and at most 1"),
    ],
)
def test_wrong_settings_are_named(wrong, message):
    with pytest.raises(InputError, match=message):
        config.parse(Refinement, wrong)


def test_a_term_whose_gradient_is_not_finite_is_named_with_its_step_and_photo(scene, monkeypatch):
    """In steps that are not compiled: those of all terms and of this one report what is not finite."""

    def make_refine_step(optimizer, terms, **_):
        values = {each.name: 1.0 for each in terms}
        metrics = SimpleNamespace(overflowed=False, finite="dssim" not in values, needed=1, terms=values)
        return lambda face_pairs, state, target, key: (state, metrics)

    monkeypatch.setattr(refinement, "make_refine_step", make_refine_step)
    state, optimizer = started(scene)
    how = {"background": BACKGROUNDS["black"], "observe": lambda *_: None, "capacity": CAPACITY}
    name = scene.frames[view_order(SETTINGS.seed, 0, len(scene.frames))].name
    with pytest.raises(InputError, match=f"^step 1, photo {name}: the gradient of the loss term 'dssim' is not finite"):
        settings, terms = replace(SETTINGS, steps=1), weigh_terms(SETTINGS.weights)
        refinement.refine(settings, terms, scene.data, state, optimizer, **how)
