"""What the front door and gsplat's stages are passed: lists and numbers are served, the rest is refused in one line."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import binned, cloud, render

import rasterizer
from rasterizer import rasterization
from rasterizer._native.tiles import MAX_SIDE

SCENE = cloud()
TWO_SCENES = jax.tree.map(lambda x: jnp.stack([x, x]), cloud(cameras=2))
SIZE = SCENE.width, SCENE.height
CAMERAS = SCENE.viewmats, SCENE.Ks


class Tensor:
    """As one of torch's: it has a shape, and a dtype that is none of numpy's."""

    shape = (40, 3)
    dtype = "torch.float32"


def zeros(*shape):
    return jnp.zeros(shape, jnp.float32)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"means": zeros(40, 2)}, r"means.shape=\(40, 2\)"),
        ({"quats": None}, "a Gaussian's shape is missing: pass quats and scales, or covars"),
        ({"covars": zeros(40, 3, 3), "return_normals": True}, "return_normals needs quats and scales"),
        ({"viewmats": np.eye(4, dtype=np.float32)}, r"viewmats.shape=\(4, 4\), expected \[C, 4, 4\]"),
        ({"viewmats": zeros(0, 4, 4), "Ks": zeros(0, 3, 3)}, r"\(0, 4, 4\) holds no camera"),
        ({"colors": zeros(2, 40, 3)}, r"colors.shape=\(2, 40, 3\), expected .* C=1"),
        ({"colors": zeros(40, 0)}, r"colors.shape=\(40, 0\) holds no channel"),
        ({"colors": None, "render_mode": "RGB+D"}, "colors=None needs a render_mode of depth alone, not 'RGB"),
        ({"sh_degree": 1}, r"colors.shape=\(40, 3\), expected \[N, K, 3\]"),
        ({"colors": zeros(40, 3, 3), "sh_degree": 1}, "degree 1 needs 4 coefficients"),
        ({"colors": zeros(40, 36, 3), "sh_degree": 5}, "degree 5"),
        ({"backgrounds": zeros(1, 5), "render_mode": "RGB+D"}, r"expected \(1, 4\) or \(1, 3\) for .*'RGB\+D'"),
        ({"masks": jnp.ones((1, 1, 1), bool)}, r"masks.shape=\(1, 1, 1\), expected \(1, 4, 5\), one per tile"),
        ({"masks": zeros(1, 4, 5)}, "masks.dtype=.*float32.*, expected bool"),
        ({"absgrad": True}, r"absgrad=True: pass zeros of shape \(1, 40, 2\), whose gradient is what gsplat writes"),
        ({"absgrad": zeros(1, 40, 2), "backend": "reference"}, "absgrad needs a tile backend, not 'reference'"),
        (
            {"absgrad": zeros(1, 40, 2), "colors": zeros(40, 17), "backgrounds": zeros(1, 17)},
            "absgrad needs a tile backend and at most 16 channels",
        ),
        ({"render_mode": "rgb"}, "render_mode='rgb' is not one of"),
        ({"backend": "cuda"}, "backend='cuda'"),
        ({"camera_model": "ftheta"}, "camera_model='ftheta' is not one of"),
        ({"radial_coeffs": zeros(1, 4)}, "radial_coeffs need camera_model='fisheye', not 'pinhole'"),
        ({"camera_model": "fisheye", "radial_coeffs": zeros(1, 6)}, r"expected \(1, 4\)"),
        ({"camera_model": "ortho", "near_plane": -1.0}, "near_plane=-1.0, expected at least 0"),
        ({"width": 0}, "width=0"),
        ({"width": 7.5}, "width=7.5, expected a whole number"),
        ({"capacity": 0}, "capacity=0"),
        ({"tile_size": MAX_SIDE + 1, "backend": "native"}, f"tile_size={MAX_SIDE + 1} is over {MAX_SIDE}"),
        ({"tile_size": 12, "backend": "pallas"}, "tile_size=12 is not a power of two"),
    ],
)
def test_what_does_not_fit(changes, message):
    with pytest.raises(ValueError, match=message) as caught:
        rasterize(**changes)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("means", "message"),
    [
        (Tensor(), r"means is of type .*Tensor, expected an array of JAX or numpy"),
        (np.zeros((40, 3), np.complex64), "means.dtype=complex64, expected real numbers"),
        (None, "means is of type builtins.NoneType"),
        ([[1, 2], [1, 2, 3]], r"means=\[\[1, 2\], \[1, 2, 3\]\] is no array of numbers"),
    ],
)
def test_what_is_no_array(means, message):
    with pytest.raises(TypeError, match=message) as caught:
        rasterize(means=means)
    assert "\n" not in str(caught.value)
    with pytest.raises(TypeError, match=message):
        rasterizer.world_to_cam(means, zeros(40, 3, 3), SCENE.viewmats)


def rasterize(**changes):
    fields = vars(SCENE) | {"capacity": 2048} | changes
    return rasterization(**fields)


def test_lists_are_arrays_and_a_number_is_the_background_of_every_channel():
    lists = {name: np.asarray(value).tolist() for name, value in vars(SCENE).items()}
    image = rasterize(**lists | {"backgrounds": 0.25})[0]
    np.testing.assert_array_equal(image, rasterize(backgrounds=jnp.full((1, 3), 0.25))[0])


@pytest.mark.parametrize(
    ("backend", "options"), [("xla", {}), ("native", {"absgrad": jnp.zeros((1, 40, 2))})], ids=["xla", "absgrad"]
)
def test_a_buffer_of_unknown_length_inside_jit(backend, options):
    with pytest.raises(ValueError, match="inside jit .* pass capacity="):
        jax.jit(lambda s: render(s, backend=backend, **options)[0])(SCENE)
    with pytest.raises(ValueError, match="inside jit .* pass capacity="):
        jax.jit(lambda *splats: rasterizer.isect_tiles(*splats, 16, 3, 2))(
            jnp.ones((1, 3, 2)), jnp.ones((1, 3, 2), jnp.int32), jnp.ones((1, 3))
        )


def rasterize_to_pixels(count, channels):
    """Of as many cameras and channels."""
    splats = np.ones((count, 2, 2)), np.ones((count, 2, 3)), np.ones((count, 2, channels)), np.ones((count, 2))
    return rasterizer.rasterize_to_pixels(*splats, 8, 8, 8, np.zeros((count, 1, 1), np.int32), np.zeros(0, np.int32))


def blend_without_lists():
    projection, grid, _ = binned(SCENE, 8)
    rasterizer.blend(projection, SCENE.opacities, SCENE.colors[None], None, grid, backend="xla")


def spherical_harmonics(degree, *shape):
    return rasterizer.spherical_harmonics(degree, jnp.ones((2, 3)), jnp.ones(shape))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: render(replace(TWO_SCENES, opacities=zeros(3, 40)), capacity=2048),
            r"opacities.shape=\(3, 40\), expected the leading dimensions of means",
        ),
        (
            lambda: render(replace(TWO_SCENES, means=TWO_SCENES.means[:0]), capacity=2048),
            r"means.shape=\(0, 40, 3\) holds no scene",
        ),
        (
            lambda: rasterizer.fully_fused_projection(SCENE.means, None, None, None, *CAMERAS, *SIZE),
            "a Gaussian's shape is missing",
        ),
        (
            lambda: rasterizer.proj(jnp.ones((1, 3, 3)), jnp.ones((1, 3, 3, 3)), SCENE.Ks, *SIZE, "lidar"),
            "camera_model='lidar' is not one of",
        ),
        (lambda: rasterize_to_pixels(1, 0), r"\(1, 2, 0\) holds no channel"),
        (lambda: rasterize_to_pixels(0, 3), r"\(0, 2, 3\) holds no camera"),
        (lambda: jax.jit(lambda width: rasterize(width=width)[0])(SCENE.width), "width is traced, but static"),
        (blend_without_lists, "pairs=None: backend='xla' needs the lists of bin_splats"),
        (lambda: spherical_harmonics(-1, 2, 36, 3), "degrees_to_use=-1, expected a whole number of at least 0"),
        (lambda: spherical_harmonics(5, 2, 36, 3), "degree 5"),
        (lambda: spherical_harmonics(2, 2, 4, 3), "degree 2 needs 9 .* holds 4"),
        (lambda: spherical_harmonics(0, 2, 25, 0), r"coeffs.shape=\(2, 25, 0\) holds no channel"),
    ],
)
def test_calls_that_do_not_fit(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    "derivative",
    [
        lambda image, colors: jax.jvp(jax.jit(image), (colors,), (colors,)),
        lambda image, colors: jax.grad(lambda c: jax.grad(lambda c: (image(c) ** 2).sum())(c).sum())(colors),
    ],
    ids=["jvp of jit", "grad of grad"],
)
def test_derivatives_that_the_tiles_do_not_have(derivative):
    with pytest.raises(TypeError, match="need backend='reference'"):
        derivative(lambda c: rasterize(colors=c)[0], SCENE.colors)
