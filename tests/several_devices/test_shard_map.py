"""A user's own `jax.shard_map`, with its default checks: every device renders its cameras of the same Gaussians."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, PartitionSpec
from tolerances import assert_close

import rasterizer
from gsjax import rendering
from gsjax.rendering import Drawable
from gsjax.scene.cameras import Camera

CAMERA, GAUSSIANS = 4, 12
SEVERAL = jax.make_mesh((4,), ("cameras",), axis_types=(AxisType.Auto,))
BY_CAMERA, SAME = PartitionSpec("cameras"), PartitionSpec()


def scene(channels=3, sh=None):
    rng = np.random.default_rng(0)
    colors = rng.uniform(0, 1, (GAUSSIANS, channels) if sh is None else (GAUSSIANS, sh, 3))
    arrays = {
        "means": rng.uniform([-1, -1, 3], [1, 1, 5], (GAUSSIANS, 3)),
        "quats": rng.normal(size=(GAUSSIANS, 4)),
        "scales": rng.uniform(0.1, 0.3, (GAUSSIANS, 3)),
        "opacities": rng.uniform(0.2, 0.9, GAUSSIANS),
        "colors": colors,
    }
    return {name: jnp.asarray(array, jnp.float32) for name, array in arrays.items()}


def cameras():
    """`[4, 4, 4]` matrices, each a step to the side, and their intrinsics."""
    viewmats = np.tile(np.eye(4, dtype=np.float32), (CAMERA, 1, 1))
    viewmats[:, 0, 3] = [0, 0.1, -0.2, 0.3]
    return jnp.asarray(viewmats), jnp.array([[[20.0, 0, 12], [0, 20, 8], [0, 0, 1]]])


def over_devices(function, out=BY_CAMERA):
    """`function(gaussians, viewmats)` with the cameras over four devices."""
    return jax.jit(jax.shard_map(function, mesh=SEVERAL, in_specs=(SAME, BY_CAMERA), out_specs=out))


def renderer(backend, **options):
    def rendered(gaussians, viewmats):
        Ks = jnp.broadcast_to(cameras()[1], (len(viewmats), 3, 3))
        how = {"capacity": 1024, "backend": backend, **options}
        image, alphas, info = rasterizer.rasterization(
            **gaussians, viewmats=viewmats, Ks=Ks, width=24, height=16, **how
        )
        return [image, alphas] + [info[name] for name in ("median_depths",) if name in info]

    return rendered


OPTIONS = {"sh_degree": 1, "render_mode": "RGB+ED", "depth_mode": "plane", "return_median_depth": True}

LONG = [pytest.param(backend, marks=pytest.mark.long) for backend in ("reference", "xla", "pallas")]


def images_and_gradients(backend, mesh=None):
    """Colours, depths and medians, and their gradients: of one device, or of the devices of a mesh."""
    rendered = renderer(backend, **OPTIONS)

    def mean_loss(gaussians, viewmats):
        images = rendered(gaussians, viewmats)
        of_device = sum(jnp.mean(part**2) for part in images)
        return of_device if mesh is None else jax.lax.pmean(of_device, "cameras"), images

    differentiated = jax.grad(mean_loss, (0, 1), has_aux=True)
    out = (SAME, BY_CAMERA), BY_CAMERA
    run = jax.jit(differentiated) if mesh is None else over_devices(differentiated, out=out)
    return run(scene(sh=4), cameras()[0])


@pytest.fixture(scope="module")
def of_one_device():
    return images_and_gradients("native")


@pytest.mark.parametrize("backend", ["native", *LONG])
def test_images_and_gradients_are_those_of_one_device(of_one_device, backend):
    expected, expected_images = of_one_device
    gradient, images = images_and_gradients(backend, SEVERAL)
    assert_close(images, expected_images)
    assert_close(gradient, expected, kind="gradient")


def test_scenes_of_their_own_in_two_passes_and_absolute_gradients():
    gaussians, viewmats = scene(channels=18), cameras()[0]

    def mapped(gaussians, viewmats):
        two = jax.tree.map(lambda x: jnp.stack([x, 0.9 * x]), gaussians)
        return jax.vmap(renderer("native"), (0, None))(two, viewmats)

    by_scene = PartitionSpec(None, "cameras")
    assert_close(over_devices(mapped, out=by_scene)(gaussians, viewmats), jax.jit(mapped)(gaussians, viewmats))
    few = {**gaussians, "colors": gaussians["colors"][:, :2]}

    def absolute(gaussians, viewmats):
        zeros = jnp.zeros_like(viewmats[:, :1, :2]) + jnp.zeros((1, GAUSSIANS, 1), jnp.float32)  # of each device
        return jax.grad(lambda zeros: jnp.sum(renderer("native", absgrad=zeros)(gaussians, viewmats)[0] ** 2))(zeros)

    assert_close(over_devices(absolute)(few, viewmats), jax.jit(absolute)(few, viewmats), kind="gradient")


def test_a_view_of_gsjax():
    gaussians, (viewmats, Ks) = scene(), cameras()
    K, black, how = Ks[0], jnp.zeros(3, jnp.float32), {"with_depth": True, "depth_mode": "front"}

    def color_and_depth(gaussians, viewmats):
        """Of one camera, as many as each device has."""
        drawable = Drawable(
            gaussians["means"],
            gaussians["opacities"],
            gaussians["colors"][:, None],
            jnp.zeros((GAUSSIANS, 0, 3), jnp.float32),
            gaussians["quats"],
            gaussians["scales"],
        )
        view = rendering.render(drawable, Camera(viewmats[0], K, 24, 16), capacity=1024, background=black, **how)
        return view.colors[None], view.depth[None]

    of_one = jax.jit(color_and_depth)
    expected = [np.concatenate(each) for each in zip(*(of_one(gaussians, v[None]) for v in viewmats), strict=True)]
    assert_close([*over_devices(color_and_depth)(gaussians, viewmats)], expected)
