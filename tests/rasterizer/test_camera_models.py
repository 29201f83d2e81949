"""Camera models: the image of a point and its Jacobian, against float64 maps written apart, and the hard places."""

import jax
import jax.numpy as jnp
import numpy as np
from scenes import single
from tolerances import assert_close

import rasterizer
from rasterizer.camera_models import CAMERA_MODELS, Lens

K = np.array([[30.0, 0, 18], [0, 33.0, 15], [0, 0, 1]])
RADIAL = (0.05, -0.02, 0.01, -0.003)
MODELS = ("pinhole", "ortho", "fisheye", "lens")
SIZE = (37, 29)


def image_of(point, model, radial=RADIAL):
    """`[2]` pixels, numpy float64: the model's definition, by angles."""
    x, y, z = point
    if model == "ortho":
        return np.array([K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]])
    if model == "pinhole":
        return np.array([K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]])
    angle, azimuth = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    if model == "lens":
        angle = angle + sum(k * angle ** (2 * n + 3) for n, k in enumerate(radial))
    return K[:2, 2] + angle * np.array([K[0, 0] * np.cos(azimuth), K[1, 1] * np.sin(azimuth)])


def jacobian_of(point, model, step=1e-5):
    """`[2, 3]` central differences of `image_of`."""
    return np.stack(
        [(image_of(point + d, model) - image_of(point - d, model)) / (2 * step) for d in step * np.eye(3)], 1
    )


def parts(vector):
    return [jnp.asarray(part) for part in vector]


@jax.jit
def _here(point, radial):
    """All models at one point in the camera: pixels and rows of the Jacobian."""
    identity = [[jnp.asarray(float(i == j), point.dtype) for j in range(3)] for i in range(3)]
    rows = [parts(row) for row in jnp.asarray(K, point.dtype)]
    ideal, lens = Lens(rows), Lens(rows, [k[None] for k in radial])
    images = {}
    for name in MODELS:
        model = CAMERA_MODELS["fisheye" if name == "lens" else name]
        mean2d, *steps = model.image_point(parts(point), identity, lens if name == "lens" else ideal, SIZE)
        images[name] = (
            jnp.stack([jnp.ravel(m)[0] for m in mean2d]),
            jnp.stack([jnp.stack([jnp.ravel(s)[0] for s in row]) for row in steps]),
        )
    return images


def here(point, dtype=np.float64, radial=RADIAL):
    return jax.tree.map(np.asarray, _here(jnp.asarray(point, dtype), jnp.asarray(radial, dtype)))


POINTS = {
    "ordinary": (0.4, -0.3, 1.5),
    "near the axis": (1e-4, 2e-4, 2.0),
    "just inside the series": (0.14, 0.0, 1.0),
    "just outside the series": (0.1415, 0.0, 1.0),
    "at the edge of the clamp": (0.5, 0.2, 1.2),
}


def test_point_and_jacobian_are_those_of_the_definition(x64):
    for point in map(np.array, POINTS.values()):
        for model, (mean2d, jacobian) in here(point).items():
            assert_close(mean2d, image_of(point, model), rtol=1e-12, why="float64")
            assert_close(jacobian, jacobian_of(point, model), rtol=1e-6, atol=1e-6, why="central differences")


def test_a_fisheye_sees_beside_and_on_the_axis(x64):
    # On the axis all directions are alike: the scale of a pinhole, and nothing along z.
    for name in ("fisheye", "lens"):
        mean2d, jacobian = here((0.0, 0.0, 2.0))[name]
        np.testing.assert_array_equal(mean2d, K[:2, 2])
        assert_close(jacobian, K[:2, :2] @ np.eye(2, 3) / 2, rtol=1e-12, why="float64")
    # 90 degrees off, where a pinhole's image ends, and beyond.
    beside = here((3.0, 0.0, 1e-9))["fisheye"][0]
    assert_close(beside, np.array([K[0, 2] + K[0, 0] * np.pi / 2, K[1, 2]]), rtol=1e-8, why="1e-9 before the plane")
    behind = np.array([0.5, 0.4, -1.0])
    assert_close(here(behind)["fisheye"][0], image_of(behind, "fisheye"), rtol=1e-12, why="float64")
    assert not np.isfinite(here((0.0, 0.0, -1.0))["fisheye"][0]).any()


def test_past_its_fold_a_lens_has_no_image():
    # theta - theta^3 / 3 grows up to one radian.
    folding = (-1 / 3, 0.0, 0.0, 0.0)
    is_finite = [
        np.isfinite(here((np.tan(a), 0.0, 1.0), np.float32, folding)["lens"][0]).all() for a in (0.9, 0.99, 1.01, 1.5)
    ]
    assert is_finite == [True, True, False, False]
    # Nor past a fold after which it would grow again.
    again = (-1.2, 0.5, 0.0, 0.0)  # grows again past 1.03
    is_finite = [np.isfinite(here((np.tan(a), 0.0, 1.0), np.float32, again)["lens"][0]).all() for a in (0.5, 0.8, 1.5)]
    assert is_finite == [True, False, False]


PLACES = [(0.0, 0.0, 2.0), (1e-9, 0.0, 1.5), (0.3, -0.2, 1.4), (0.14, 0.02, 1.0), (-0.5, 0.4, 0.3)]


def test_gradients_of_points_and_jacobians_are_finite_differences(x64):
    rng = np.random.default_rng(5)
    inputs = {
        "points": jnp.asarray(PLACES),
        "viewmat": jnp.asarray(rng.normal(size=(3, 4))),
        "K": jnp.asarray(K),
        "radial": jnp.asarray(RADIAL),
    }
    weights = [jnp.asarray(rng.normal(size=(5, n))) for n in (2, 3, 3)]

    def total(model, points, viewmat, K, radial):
        lens = Lens([parts(row) for row in K], None if model == "ortho" else [k[None] for k in radial])
        viewmat = [parts(row) for row in viewmat]
        image = CAMERA_MODELS[model].image_point([points[:, i] for i in range(3)], viewmat, lens, SIZE)
        return sum(
            jnp.sum(w[:, i] * part) for w, each in zip(weights, image, strict=True) for i, part in enumerate(each)
        )

    value_and_grad = jax.jit(
        lambda inputs: {m: jax.value_and_grad(lambda x, m=m: total(m, **x))(inputs) for m in ("ortho", "fisheye")}
    )
    gradients = value_and_grad(inputs)
    for name, array in inputs.items():
        way, step = jnp.asarray(rng.normal(size=array.shape)), 1e-6
        ahead, back = (value_and_grad(inputs | {name: array + sign * step * way}) for sign in (1, -1))
        for model, (_, gradient) in gradients.items():
            expected = (ahead[model][0] - back[model][0]) / (2 * step)
            np.testing.assert_allclose(jnp.sum(gradient[name] * way), expected, rtol=1e-6, atol=1e-8, err_msg=name)


def test_a_parallel_projection_sees_along_z():
    # A disc far beside the axis, turned towards it, shows its other side to a camera in the origin.
    tilted = single(mean=(9.0, 0.0, 2.0), quat=(0.98, 0.0, -0.2, 0.0), scale=(0.1, 0.1, 0.001))
    visible = jnp.ones((1, 1), bool)
    shape = tilted.means, tilted.quats, tilted.scales, tilted.viewmats, visible
    facing, turned = (rasterizer.camera_normals(*shape, model)[0, 0] for model in ("ortho", "pinhole"))
    assert facing[2] < 0 < turned[2]
