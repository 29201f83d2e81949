from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gsjax.analytic import solids, true_surface
from gsjax.scene.cameras import center, unproject
from gsjax.scene.meshes import signed_volume

SDF = jax.jit(jax.vmap(solids.scene_sdf))
SPACING = 0.04
# What the session's flags turn off (tests/conftest.py), for what only optimisation shows.
AS_USERS_RUN = (
    {
        "xla_cpu_use_fusion_emitters": True,
        "xla_backend_optimization_level": 3,
        "xla_llvm_disable_expensive_passes": False,
    }
    if version("jaxlib").startswith("0.10.")
    else None
)
BOX_TOP = np.float32([-0.36, 0.30, 0.54])  # above the carved box's foot


@pytest.fixture(scope="module")
def camera():
    return solids.cameras(5, (56, 48), seed=3)[4]


@pytest.fixture(scope="module")
def view(camera):
    return jax.tree.map(np.asarray, solids.trace(camera, samples=2))


@pytest.fixture(scope="module")
def world_points(camera, view):
    """`[H, W, 3]` unprojected depth, world."""
    pose = np.asarray(camera.viewmat, np.float64)
    return (np.asarray(unproject(jnp.asarray(view.depth), camera)) - pose[:3, 3]) @ pose[:3, :3]


@pytest.fixture(scope="module")
def surface():
    return true_surface.mesh(SPACING)


def random_points(count, seed=0):
    return np.random.default_rng(seed).uniform(*solids.BOUNDS, (count, 3)).astype(np.float32)


def test_the_distance_never_exceeds_the_true_one():
    a = random_points(20_000)
    b = a + np.random.default_rng(1).normal(0, 0.1, a.shape).astype(np.float32)
    change, distance = np.abs(SDF(a) - SDF(b)), np.linalg.norm(a - b, axis=1)
    assert np.all(change <= distance + 1e-5)


def test_hits_lie_on_the_surface(view, world_points):
    hit = view.depth > 0
    assert 0.3 < hit.mean() < 1
    assert np.abs(SDF(world_points[hit].astype(np.float32))).max() < 1e-4


def test_rays_without_a_hit_leave_the_world(camera, view):
    rays = np.asarray(unproject(jnp.ones(view.depth.shape, jnp.float32), camera))[view.depth == 0]
    directions = rays @ np.asarray(camera.viewmat)[:3, :3]
    eye = np.asarray(center(camera))
    blocked = np.zeros(len(rays), bool)
    for depth in np.linspace(1.0, 6.0, 400, dtype=np.float32):
        blocked |= np.asarray(SDF((eye + depth * directions).astype(np.float32))) < -2e-3
    assert blocked.mean() < 3e-3  # a grazing ray in a thousand stays undecided


def test_every_hit_on_a_face_has_its_normal():
    x, y = np.meshgrid(np.linspace(-0.1, 0.05, 40), np.linspace(-0.05, 0.1, 40))
    above = (BOX_TOP + np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1)).astype(np.float32)
    down = np.broadcast_to(np.float32([0, 0, -1]), above.shape)
    hits = solids._just_before(above, down, solids._cast_all(above, down))
    on_top = np.abs(hits[:, 2] - BOX_TOP[2]) < 1e-3
    assert on_top.sum() > 800
    np.testing.assert_allclose(solids.normal_all(hits)[on_top], np.eye(3)[[2] * on_top.sum()], atol=1e-6)


def test_labels_name_what_is_hit(view, world_points):
    assert set(np.unique(view.labels)) == {0, 1, 2, 3, 4, 5, 255}
    np.testing.assert_array_equal(view.labels == 0, view.depth == 0)
    assert view.colors.min() >= 0 and view.colors.max() <= 1 + 1e-5
    on_table = world_points[view.labels == solids.GROUND_LABEL]
    assert np.all(on_table[:, 2] < 1e-4)
    assert np.all(np.linalg.norm(on_table[:, :2], axis=1) < solids.TABLE_RADIUS + 1e-4)


def test_the_sun_casts_shadows():
    sun = solids._SUN
    behind_box = BOX_TOP - 0.3 * sun  # inside the box's shadow whatever the bowl takes away
    on_table = behind_box - sun * behind_box[2] / sun[2]
    points = np.float32([on_table, [1.3, 0.9, 0.0]]) + np.float32([0, 0, 2e-3])
    np.testing.assert_allclose(jax.vmap(solids.sun_visibility)(points), [0.0, 1.0], atol=1e-3)


def test_a_point_is_visible_where_the_depth_map_shows_it(camera, view, world_points):
    hit = view.depth > 0
    facing = -np.sum(view.normals * np.asarray(unproject(jnp.ones(hit.shape, jnp.float32), camera)), axis=-1)[hit] > 0.2
    visible_all = jax.jit(jax.vmap(solids.visible, in_axes=(0, None)))
    surface_points = world_points[hit].astype(np.float32)
    # But for rays that graze another solid on their way.
    assert np.asarray(visible_all(surface_points, camera))[facing].mean() > 0.99
    eye = np.asarray(center(camera))
    behind = surface_points + np.float32(0.05) * (surface_points - eye) / np.linalg.norm(
        surface_points - eye, axis=1, keepdims=True
    )
    assert not np.asarray(visible_all(behind, camera)).any()
    outside = eye + 3 * (eye - surface_points)
    assert not np.asarray(visible_all(outside.astype(np.float32), camera)).any()


def test_the_distance_beside_its_gradient_is_the_distance_alone():
    """On faces, where terms are zero but for rounding: optimised programs compute them twice, and round them apart."""

    def optimised(function, points):
        return jax.jit(jax.vmap(function)).lower(points).compile(compiler_options=AS_USERS_RUN)(points)

    beside_the_box = np.random.default_rng(0).uniform([-0.6, 0.1, 0.02], [-0.1, 0.5, 0.6], (4000, 3)).astype(np.float32)
    on_faces = optimised(lambda p: p - solids.scene_sdf(p) * solids.normal(p), beside_the_box)
    values, _ = optimised(jax.value_and_grad(solids.scene_sdf), on_faces)
    np.testing.assert_allclose(values, SDF(on_faces), atol=1e-6)


def test_the_mesh_is_closed_outward_and_on_the_surface(surface):
    edges = np.concatenate([surface.faces[:, [i, (i + 1) % 3]] for i in range(3)])
    forward, backward = ({tuple(e) for e in edges[:, order].tolist()} for order in ([0, 1], [1, 0]))
    assert forward == backward  # every edge has its opposite: closed, one orientation
    distances = np.abs(SDF(surface.vertices))
    assert np.mean(distances < 1e-4) > 0.999
    assert distances.max() < 0.2 * SPACING  # in the wedge under the ring
    inside = SDF(random_points(400_000, seed=5)) < 0
    volume = np.mean(inside) * np.prod(np.subtract(*solids.BOUNDS[::-1]))
    np.testing.assert_allclose(signed_volume(surface), volume, rtol=0.03)


def test_samples_are_spread_evenly_and_exactly_on_the_surface(surface):
    points, normals, on_table = true_surface.sample_points(surface, 5_000, 20_000, seed=0)
    assert np.abs(SDF(points)).max() < 1e-4
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    table, solid_points = points[on_table], points[~on_table]
    assert 4_900 < len(solid_points) <= 5_000
    assert np.mean(solid_points[:, 2] > 0.02) > 0.9
    radii = np.linalg.norm(table[:, :2], axis=1)
    np.testing.assert_allclose(table[radii > 0.9, 2], 0, atol=1e-5)
    inner, outer = (np.mean((radii > r) & (radii < r + 0.2)) for r in (1.0, 1.3))
    np.testing.assert_allclose(outer / inner, (1.5**2 - 1.3**2) / (1.2**2 - 1.0**2), rtol=0.1)
