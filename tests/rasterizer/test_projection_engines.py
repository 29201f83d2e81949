"""The projection in native loops against float64: values and gradients, of hard Gaussians too."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import camera_at, intrinsics
from tolerances import assert_close

from rasterizer import project

WIDTH, HEIGHT, COUNT = 64, 48, 1100  # more Gaussians than a thread takes at a time, and part of a vector
DIFFERENTIABLE = "means2d", "depths", "conics", "compensations", "slopes"
OPTIONS = {"classic": {}, "antialiased planes": {"rasterize_mode": "antialiased", "depth_mode": "plane"}}
TURN = (1, 0.3, 0.2, 0.1)
# Mean, quaternion, scales, opacity.
HARD = {
    "a zero quaternion": ((0.1, 0, 2), (0, 0, 0, 0), (0.1, 0.2, 0.3), 0.5),
    "a long quaternion": ((0.1, 0, 2), (1e20, 2e20, 0, 1e20), (0.1, 0.2, 0.3), 0.5),
    "a short quaternion": ((0.1, 0, 2), (1e-11, 2e-11, 0, 1e-11), (0.1, 0.2, 0.3), 0.5),
    "a needle": ((0.1, 0.1, 2), TURN, (1e-4, 1e-4, 1), 0.5),
    "a disc": ((0.1, 0.1, 2), TURN, (0.3, 0.3, 0), 0.5),
    "a point": ((0.1, 0.1, 2), TURN, (0, 0, 0), 0.5),
    "a plane seen edge on": ((0, 0, 0.5), (1, 0.7, 0, 0), (3, 3, 1e-3), 0.9),
    "beside the image, where the affine map is held": ((2.5, 0, 2), TURN, (0.9, 0.9, 0.9), 0.9),
}
OVERFLOWS = ((0, 0, 2), TURN, (1e25, 1e25, 1e25), 0.5)  # its covariance, in float32


def hard_and_random():
    """Float32 means, quaternions, scales, opacities, viewmats and Ks."""
    rng = np.random.default_rng(5)
    cloud = (
        rng.normal(size=(COUNT, 3)) * (1, 1, 0.5) + (0, 0, 2.5),
        rng.normal(size=(COUNT, 4)),
        np.exp(rng.normal(-3, 1, (COUNT, 3))),
        rng.uniform(0.02, 1, COUNT),
    )
    hard = zip(OVERFLOWS, *HARD.values(), strict=True)
    gaussians = (np.concatenate([np.array(some, float), many]) for some, many in zip(hard, cloud, strict=True))
    cameras = [camera_at(), camera_at(0, 0, 0.02, yaw=0.05)], [intrinsics(WIDTH, HEIGHT)] * 2
    return [np.asarray(part, np.float32) for part in (*gaussians, *cameras)]


def with_gradients(arrays, cotangents, *, backend, **options):
    """What shows, its numbers, and gradients to means, quats and scales of them times cotangents."""

    def visible_parts(means, quats, scales):
        p = project(means, quats, scales, *arrays[3:], WIDTH, HEIGHT, backend=backend, **options)
        parts = {name: part for name in DIFFERENTIABLE if (part := getattr(p, name)) is not None}
        return {n: jnp.where(jnp.expand_dims(p.visible, range(2, x.ndim)), x, 0) for n, x in parts.items()}, p

    parts, pullback, projection = jax.vjp(visible_parts, *arrays[:3], has_aux=True)
    pulled = pullback({name: cotangents[name].astype(part.dtype) for name, part in parts.items()})
    gradients = dict(zip(("means", "quats", "scales"), pulled, strict=True))
    return projection.visible, parts | {"extents": projection.extents}, gradients


@pytest.mark.parametrize("mode", OPTIONS)
def test_values_and_gradients_against_float64(mode):
    arrays, rng = hard_and_random(), np.random.default_rng(6)
    rows = 2, len(arrays[0])
    widths = {"means2d": (2,), "depths": (), "conics": (3,), "compensations": (), "slopes": (2,)}
    cotangents = {name: rng.normal(size=(*rows, *width)) for name, width in widths.items()}
    run = partial(with_gradients, **OPTIONS[mode])
    visible, values, gradients = jax.jit(partial(run, backend="native"))(arrays, cotangents)
    with jax.enable_x64(True):
        exact = [jnp.asarray(part, jnp.float64) for part in arrays]
        is_visible, expected, pulled = jax.tree.map(np.asarray, run(exact, cotangents, backend="reference"))

    assert not visible[:, 0].any()
    np.testing.assert_array_equal(visible[:, 1:], is_visible[:, 1:])
    assert is_visible[:, 1 : 1 + len(HARD)].all() or mode != "classic"  # A sharp point is too faint.
    for name, part in expected.items():
        size = np.abs(part[:, 1:]).max()
        assert_close(values[name][:, 1:], part[:, 1:], rtol=1e-4, atol=1e-5 * size, why="needles beside far splats")
    for name in ("means", "quats", "scales"):
        part = pulled[name][1:]
        size = np.abs(part).max()
        assert_close(gradients[name][1:], part, rtol=1e-3, atol=1e-5 * size, why="needles beside far splats")
        np.testing.assert_array_equal(np.asarray(gradients[name])[0], 0)
