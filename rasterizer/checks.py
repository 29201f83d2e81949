"""What the front door refuses, each in one line with the value in it; and its leading dimensions, one call a scene."""

import inspect
from collections.abc import Callable
from functools import wraps
from math import prod
from typing import Any, ParamSpec, TypeVar, cast, get_args

import jax
import jax.numpy as jnp
from jax import Array

from rasterizer.binning import TileGrid
from rasterizer.features import RenderMode, num_channels
from rasterizer.projection import require_shape

P = ParamSpec("P")
R = TypeVar("R")
SHAPES: dict[str, tuple[int | str, ...]] = {
    "means": ("N", 3),
    "quats": ("N", 4),
    "scales": ("N", 3),
    "opacities": ("N",),
    "viewmats": ("C", 4, 4),
    "Ks": ("C", 3, 3),
    "covars": ("N", 3, 3),
    "radial_coeffs": ("C", 4),
    "backgrounds": ("C", "X"),
    "masks": ("C", "Y", "X"),
    "means2d_probe": ("C", "N", 2),
    "absgrad": ("C", "N", 2),
}  # of one scene's arrays; colours have several


def maps_over_batches(render: Callable[P, R]) -> Callable[P, R]:
    """The function of one scene, as one of `[...]` scenes: those of the leading dimensions that `means` has.

    An array without them is the same for all scenes. Every array that comes back has them.

    Raises:
        ValueError: An array has other leading dimensions than `means`, or these hold no scene.
    """
    signature, by_name = inspect.signature(render), cast("Callable[..., Any]", render)

    @wraps(render)
    def with_batches(*args: P.args, **kwargs: P.kwargs) -> R:
        arguments = signature.bind(*args, **kwargs).arguments
        batch = arguments["means"].shape[:-2]
        if not batch:
            return render(*args, **kwargs)
        if not prod(batch):
            raise ValueError(f"means.shape={arguments['means'].shape} holds no scene")
        mapped = {
            name: array.reshape(-1, *array.shape[len(batch) :])
            for name, array in arguments.items()
            if name in (*SHAPES, "colors") and _has_batch(name, array, batch, arguments.get("sh_degree"))
        }
        results = jax.vmap(lambda arrays: by_name(**{**arguments, **arrays}))(mapped)
        return jax.tree.map(lambda result: result.reshape(*batch, *result.shape[1:]), results)

    return with_batches


def _has_batch(name: str, array: Array | bool | None, batch: tuple[int, ...], sh_degree: int | None) -> bool:
    """Whether an argument has the leading dimensions; raises where it has others."""
    if array is None or isinstance(array, bool):
        return False
    if name == "colors":
        # Without harmonics they are of every Gaussian of a scene, or of every camera and Gaussian.
        ranks, is_shared = ((3,), array.ndim == 3) if sh_degree is not None else ((2, 3), array.ndim == 2)
    else:
        ranks = (len(SHAPES[name]),)
        is_shared = array.ndim in (ranks[0], 0)
    if is_shared:
        return False
    if array.ndim - len(batch) not in ranks or array.shape[: len(batch)] != batch:
        raise ValueError(f"{name}.shape={array.shape}, expected the leading dimensions of means, {batch}, or none")
    return True


def check_mode(kind: Any, **modes: Any) -> None:
    """Raise ValueError where a mode is none of its kind, a `Literal`."""
    for name, value in modes.items():
        if value not in get_args(kind):
            raise ValueError(f"{name}={value!r} is not one of {get_args(kind)}")


def check_lenses(camera_model: str, radial_coeffs: Array | None, near_plane: float) -> None:
    """Raise ValueError where a lens has coefficients that its model does not read, or splats could be behind it."""
    if near_plane < 0:
        raise ValueError(f"{near_plane=}, expected at least 0: splats are sorted by their depth in front of the camera")
    if radial_coeffs is not None and camera_model != "fisheye":
        raise ValueError(f"radial_coeffs need camera_model='fisheye', not {camera_model!r}: undistort the photos")


def absgrad_zeros(absgrad, shape: tuple[int, ...]) -> Array | None:
    """The array whose gradient takes what gsplat writes to `means2d.absgrad`; None where that is not requested.

    Raises:
        ValueError: It is True, which a function without side effects cannot answer to, or of another shape.
    """
    if absgrad is True or (absgrad is not False and absgrad is not None and absgrad.shape != shape):
        value = "True" if absgrad is True else f"[{', '.join(map(str, absgrad.shape))}]"
        raise ValueError(
            f"absgrad={value}: pass zeros of shape {shape}, whose gradient is what gsplat writes to means2d.absgrad"
        )
    return None if absgrad is False else absgrad


def check_counts(means: Array, viewmats: Array, colors: Array | None) -> None:
    """Raise ValueError where there are not N Gaussians and C cameras, or there is no camera or no channel."""
    if means.ndim != 2:
        raise ValueError(f"{means.shape=}, expected [N, 3]")
    if viewmats.ndim != 3:
        raise ValueError(f"{viewmats.shape=}, expected [C, 4, 4]")
    if viewmats.shape[0] == 0:
        raise ValueError(f"{viewmats.shape=} holds no camera")
    if colors is not None and (colors.ndim == 0 or colors.shape[-1] == 0):
        raise ValueError(f"{colors.shape=} holds no channel")


def check_arrays(
    arrays: dict[str, Any], num_gaussians: int, grid: TileGrid, sh_degree: int | None, render_mode: RenderMode
) -> None:
    """Raise ValueError where shapes do not fit each other, or masks are no truth values."""
    arrays = dict(arrays)
    require_shape(arrays["quats"], arrays["scales"], arrays["covars"])
    if arrays["covars"] is not None:
        arrays |= {"quats": None, "scales": None}
    masks, colors, backgrounds = arrays["masks"], arrays.pop("colors"), arrays.pop("backgrounds")
    _check_colors(colors, num_gaussians, grid.num_cameras, sh_degree, render_mode)
    _check_backgrounds(backgrounds, colors, grid.num_cameras, render_mode)
    if masks is not None and masks.dtype != jnp.bool_:
        raise ValueError(f"{masks.dtype=}, expected bool")
    sizes = {"N": num_gaussians, "C": grid.num_cameras, "Y": grid.tiles_y, "X": grid.tiles_x}
    for name, array in arrays.items():
        expected = tuple(sizes[size] if isinstance(size, str) else size for size in SHAPES[name])
        if array is not None and array.shape != expected:
            of = "one per tile" if name == "masks" else f"for {num_gaussians} Gaussians"
            raise ValueError(f"{name}.shape={array.shape}, expected {expected}, {of}")


def _check_colors(colors, num_gaussians, num_cameras, sh_degree, render_mode) -> None:
    if colors is None:
        if "RGB" in render_mode:
            raise ValueError(f"colors=None needs a render_mode of depth alone, not {render_mode!r}")
        return
    leading = (num_gaussians,) if colors.ndim == 2 or sh_degree is not None else (num_cameras, num_gaussians)
    if colors.shape[: len(leading)] != leading or colors.ndim != len(leading) + (1 if sh_degree is None else 2):
        kind = "[N, K, 3] with sh_degree" if sh_degree is not None else "[N, D] or [C, N, D]"
        raise ValueError(f"colors.shape={colors.shape}, expected {kind} with N={num_gaussians}, C={num_cameras}")


def _check_backgrounds(backgrounds, colors, num_cameras, render_mode) -> None:
    if backgrounds is None:
        return
    channels = [num_channels(colors, render_mode), *([] if colors is None else [colors.shape[-1]])]
    expected = dict.fromkeys((num_cameras, count) for count in channels)
    if backgrounds.shape not in expected:
        raise ValueError(f"{backgrounds.shape=}, expected {' or '.join(map(str, expected))} for {render_mode=}")
