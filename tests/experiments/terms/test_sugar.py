"""SuGaR's terms: Gaussians alone have closed forms, a plane of them agrees with itself, and bad input stays finite."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expit
from small_scenes import camera_at, cloud, plane
from terms import sugar, surroundings
from terms.sugar import sugar_density, sugar_sdf
from terms.surroundings import Around
from tolerances import assert_close

from gsjax.gaussians import is_alive, rotation_matrices
from gsjax.rendering import View
from gsjax.scene.batches import Batch

pytestmark = pytest.mark.long  # what studies alone hand in

COUNT, DISTANCE, EXTENT = 36, 4.0, 2.5
CAMERA = camera_at(size=(40, 36), focal=36.0)
KEY = jax.random.key(3)
DEPTH = jnp.full((36, 40), DISTANCE, jnp.float32)
ALL = jnp.ones(COUNT, bool)
SPLATS = SimpleNamespace(projection=SimpleNamespace(visible=ALL[None]))
TERMS = (sugar_sdf, sugar_density)
WALL = plane((0.0, 0.0, -1.0), per_side=6, spacing=0.25, radius=0.2, opacity=0.3)


def nearest_of(gaussians):
    return surroundings.nearest(np.asarray(gaussians.means), np.asarray(is_alive(gaussians)))


@jax.jit
def values_and_gradient(gaussians, nearest):
    """Both values, and the gradient of their sum."""

    def total(gaussians, depth):
        view, around = View(None, depth, depth, SPLATS), Around(nearest, KEY, EXTENT)
        batch = Batch(CAMERA, None, None, None, None)
        values = jnp.stack([term(gaussians, view, batch, around) for term in TERMS])
        return jnp.sum(values), values

    (_, values), gradient = jax.value_and_grad(total, (0, 1), has_aux=True)(gaussians, DEPTH)
    return values, gradient


def unit_facing(normals, towards):
    return normals * np.where(np.sum(normals * towards, -1, keepdims=True) < 0, -1, 1)


def expected_terms(gaussians, nearest):
    """Both terms written out in float64, of Gaussians at a depth of `DISTANCE` that are all close to it."""
    who, how = jax.random.split(KEY)
    owners = np.asarray(sugar.choose_rows(who, ALL, COUNT))
    noise = np.asarray(jax.random.normal(how, (COUNT, 3)), np.float64)
    means, log_scales, logits = (
        np.asarray(getattr(gaussians, name), np.float64) for name in ("means", "log_scales", "logit_opacities")
    )
    axes, deviations, alpha = (
        np.asarray(rotation_matrices(gaussians.quats), np.float64),
        np.exp(log_scales),
        expit(logits),
    )
    normals = np.take_along_axis(axes, deviations.argmin(1)[:, None, None], 2)[..., 0]
    points = means[owners] + 1.5 * np.einsum("nij,nj->ni", axes[owners], noise * deviations[owners])
    pixels = points[:, :2] / points[:, 2:] * np.diag(CAMERA.K)[:2] + np.asarray(CAMERA.K)[:2, 2] - 0.5
    reads = np.all((pixels >= 0) & (pixels <= [39, 35]), -1)

    ids = nearest[owners]
    counts = (ids != owners[:, None]) | (np.arange(ids.shape[1]) == 0)
    offsets = points[:, None] - means[ids]
    whitened = np.einsum("nkji,nkj->nki", axes[ids], offsets) / deviations[ids]
    each = counts * alpha[ids] * np.exp(-0.5 * np.sum(whitened**2, -1))
    density, beta = each.sum(1), deviations.min(1)[ids].mean(1)

    field = beta * np.sqrt(-2 * np.log(np.maximum(density / 16, 1e-16)))
    to_depth = np.abs(DISTANCE - points[:, 2])
    off_plane = np.sum((points - means[owners]) * normals[owners], -1)
    target = np.exp(-0.5 * (off_plane / beta) ** 2)

    around = unit_facing(normals[ids], normals[owners][:, None])
    weights = each * np.abs(np.sum(offsets * around, -1)) / deviations.min(1)[ids] ** 2
    weights /= np.maximum(weights.sum(1, keepdims=True), 1e-6)
    apart = np.sum((normals[owners] - np.einsum("nk,nki->ni", weights, around)) ** 2, -1).mean()
    assert 20 < reads.sum() < COUNT or reads.all()
    return np.array(
        [
            np.abs(field - to_depth)[reads].mean() / (EXTENT / 10) + apart,
            np.abs(np.minimum(density, 1) - target).mean() + apart,
        ]
    )


FLIPPED = replace(WALL, quats=jnp.where(np.arange(COUNT)[:, None] % 2, WALL.quats, jnp.asarray([[0.0, 1.0, 0.0, 0.0]])))
AT_DEPTH = replace(
    cloud(COUNT, seed=2), means=cloud(COUNT, seed=2).means.at[:, 2].set(DISTANCE + jnp.linspace(-0.05, 0.05, COUNT))
)


@pytest.mark.parametrize("alone", [True, False])
@pytest.mark.parametrize("gaussians", [AT_DEPTH, FLIPPED], ids=["a cloud", "a wall, half of it upside down"])
def test_the_terms_are_those_written_out_in_float64(gaussians, alone):
    nearest = surroundings.none_yet(COUNT) if alone else nearest_of(gaussians)
    values, _ = values_and_gradient(gaussians, nearest)
    why = "float32 over deviations of a hundredth of a unit"
    assert_close(values, expected_terms(gaussians, nearest), rtol=1e-4, atol=0, why=why)


HARD = {
    "coincident and opaque": replace(
        WALL,
        logit_opacities=jnp.full(COUNT, 40, jnp.float32),
        means=jnp.tile(jnp.asarray([[0.1, 0.1, DISTANCE]]), (COUNT, 1)),
    ),
    "opacity 0": replace(WALL, logit_opacities=jnp.full(COUNT, -200, jnp.float32)),
    "needles": replace(WALL, log_scales=jnp.tile(jnp.asarray([[-18.0, 1.0, -18.0]]), (COUNT, 1))),
    "collapsed": replace(WALL, log_scales=jnp.full((COUNT, 3), -90.0)),
    "no rotation": replace(WALL, quats=jnp.zeros((COUNT, 4))),
    "at the camera": replace(WALL, means=WALL.means * jnp.asarray([[1.0, 1.0, 0.0]])),
    "behind": replace(WALL, means=-WALL.means),
}


@pytest.mark.parametrize("name", HARD)
def test_value_and_gradient_are_finite(name):
    for nearest in (nearest_of(HARD[name]), surroundings.none_yet(COUNT)):
        values, gradient = values_and_gradient(HARD[name], nearest)
        assert np.all((np.asarray(values) >= 0) & (np.asarray(values) < 1e12))
        assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(gradient))
