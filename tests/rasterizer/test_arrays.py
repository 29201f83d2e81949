"""What callers hand over for an array: lists and numbers are served, what is no array is named in one line."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import cloud

import rasterizer
from rasterizer import rasterization
from rasterizer.arrays import takes_arrays

SCENE = cloud()
ARRAYS = {name: np.asarray(getattr(SCENE, name)) for name in ("means", "quats", "scales", "opacities", "colors")}
ARRAYS |= {"viewmats": np.asarray(SCENE.viewmats), "Ks": np.asarray(SCENE.Ks)}


def image(**changes):
    return rasterization(**{**ARRAYS, **changes}, width=SCENE.width, height=SCENE.height, capacity=2048)[0]


def test_lists_are_arrays():
    lists = {name: array.tolist() for name, array in ARRAYS.items()}
    np.testing.assert_array_equal(image(**lists), image())


def test_a_number_is_the_background_of_every_channel():
    behind = jnp.full((len(ARRAYS["viewmats"]), ARRAYS["colors"].shape[-1]), 0.25)
    np.testing.assert_array_equal(image(backgrounds=0.25), image(backgrounds=behind))


def test_all_arrays_come_in_one_float_dtype_but_masks_and_indices():
    @takes_arrays
    def dtypes(means: jnp.ndarray, scales: jnp.ndarray, masks: jnp.ndarray | None = None):
        return means.dtype, scales.dtype, None if masks is None else masks.dtype

    assert dtypes([[1, 2, 3]], np.ones((1, 3), np.float16), [True]) == (np.float32, np.float32, np.bool_)
    assert dtypes(jnp.ones(3, jnp.bfloat16), np.ones(3, np.int32)) == (np.float32, np.float32, None)
    assert dtypes(np.ones(3), np.ones(3, np.float32)) == (np.float64, np.float32, None)  # jax reads both as float32
    assert dtypes(1, 2) == (np.float32, np.float32, None)
    with jax.enable_x64(True):
        assert dtypes(np.ones(3), np.ones(3, np.float32)) == (np.float64, np.float64, None)
        assert dtypes(np.ones(3, np.float32), np.ones(3)) == (np.float32, np.float32, None)


class Tensor:
    """As one of torch's: it has a shape, and a dtype that is none of numpy's."""

    shape = (40, 3)
    dtype = "torch.float32"


@pytest.mark.parametrize(
    ("changes", "fault", "message"),
    [
        ({"means": Tensor()}, TypeError, r"means is of type .*Tensor, expected an array of JAX or numpy"),
        ({"means": ARRAYS["means"].astype(np.complex64)}, TypeError, r"means.dtype=complex64, expected real numbers"),
        ({"means": None}, TypeError, r"means is of type builtins.NoneType"),
        ({"means": "x"}, TypeError, r"means is of type builtins.str"),
        ({"means": [[1, 2], [1, 2, 3]]}, TypeError, r"means=\[\[1, 2\], \[1, 2, 3\]\] is no array of numbers"),
        ({"means": 1.0}, ValueError, r"means.shape=\(\), expected \[N, 3\]"),
        ({"viewmats": np.eye(4, dtype=np.float32)}, ValueError, r"viewmats.shape=\(4, 4\), expected \[C, 4, 4\]"),
        (
            {name: ARRAYS[name][:0] for name in ("viewmats", "Ks")},
            ValueError,
            r"\(0, 4, 4\) holds no camera",
        ),
        ({"colors": ARRAYS["colors"][:, :0]}, ValueError, r"colors.shape=\(40, 0\) holds no channel"),
        ({"colors": 1.0}, ValueError, r"colors.shape=\(\) holds no channel"),
    ],
)
def test_the_front_door_says_what_it_cannot_take(changes, fault, message):
    with pytest.raises(fault, match=message) as caught:
        image(**changes)
    assert "\n" not in str(caught.value)


def staged(means, covars, viewmats, Ks, colors, opacities, backgrounds):
    """An image through every stage, whatever kind of arrays it is given."""
    like = (lambda x: x.tolist()) if isinstance(means, list) else lambda x: x
    means_cam, covars_cam = map(like, rasterizer.world_to_cam(means, covars, viewmats))
    means2d, _ = rasterizer.proj(means_cam, covars_cam, Ks, SCENE.width, SCENE.height)
    triangles = np.asarray(covars)[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    radii, _, depths, conics, _ = rasterizer.fully_fused_projection(
        means, like(triangles), None, None, viewmats, Ks, SCENE.width, SCENE.height
    )
    tiles = -(-SCENE.width // 8), -(-SCENE.height // 8)
    _, ids, flat = rasterizer.isect_tiles(like(means2d), like(radii), like(depths), 8, *tiles)
    offsets = rasterizer.isect_offset_encode(like(ids), 1, *tiles)
    splats = like(means2d), like(conics), [colors] if isinstance(colors, list) else colors[None]
    opacities = [opacities] if isinstance(opacities, list) else opacities[None]
    size = SCENE.width, SCENE.height, 8
    return rasterizer.rasterize_to_pixels(*splats, opacities, *size, like(offsets), like(flat), backgrounds)[0]


def test_the_stages_take_lists():
    covars, _ = rasterizer.quat_scale_to_covar_preci(ARRAYS["quats"].tolist(), ARRAYS["scales"].tolist())
    assert covars is not None
    arrays = (
        ARRAYS["means"],
        np.asarray(covars),
        ARRAYS["viewmats"],
        ARRAYS["Ks"],
        ARRAYS["colors"],
        ARRAYS["opacities"],
    )
    of_lists = staged(*(array.tolist() for array in arrays), backgrounds=0.5)
    of_arrays = staged(*arrays, backgrounds=np.full(ARRAYS["colors"].shape[-1], 0.5, np.float32))
    np.testing.assert_array_equal(of_lists, of_arrays)


def test_the_stages_say_what_they_cannot_take():
    with pytest.raises(TypeError, match="means is of type .*Tensor"):
        rasterizer.world_to_cam(Tensor(), Tensor(), Tensor())
    with pytest.raises(ValueError, match="a Gaussian's shape is missing"):
        cameras = ARRAYS["viewmats"], ARRAYS["Ks"]
        rasterizer.fully_fused_projection(ARRAYS["means"], None, None, None, *cameras, SCENE.width, SCENE.height)
    for count, channels, message in ((1, 0, r"\(1, 2, 0\) holds no channel"), (0, 3, r"\(0, 2, 3\) holds no camera")):
        splats = np.ones((count, 2, 2)), np.ones((count, 2, 3)), np.ones((count, 2, channels)), np.ones((count, 2))
        offsets, flat = np.zeros((count, 1, 1), np.int32), np.zeros(0, np.int32)
        with pytest.raises(ValueError, match=message):
            rasterizer.rasterize_to_pixels(*splats, 8, 8, 8, offsets, flat)
