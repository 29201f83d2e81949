"""What the front door refuses, each in one line with the value in it."""

from typing import get_args

import jax.numpy as jnp
from jax import Array

from rasterizer.camera_models import CameraModelName
from rasterizer.engines import Backend
from rasterizer.features import RenderMode, num_channels
from rasterizer.projection import DepthMode, RasterizeMode, require_shape


def check_modes(render_mode, rasterize_mode, depth_mode, camera_model, backend) -> None:
    """Raise ValueError where a mode is none."""
    check_mode(RenderMode, render_mode=render_mode)
    check_mode(RasterizeMode, rasterize_mode=rasterize_mode)
    check_mode(DepthMode, depth_mode=depth_mode)
    check_mode(CameraModelName, camera_model=camera_model)
    check_mode(Backend, backend=backend)


def check_mode(kind, **modes) -> None:
    """Raise ValueError where a mode is none of its kind, a `Literal`."""
    for name, value in modes.items():
        if value not in get_args(kind):
            raise ValueError(f"{name}={value!r} is not one of {get_args(kind)}")


def check_probe(probe: Array | None, shape: tuple[int, ...]) -> None:
    """Raise ValueError where the probe has another shape than the projected means."""
    if probe is not None and probe.shape != shape:
        raise ValueError(f"means2d_probe.shape={probe.shape}, expected {shape}")


def check_lenses(radial_coeffs, num_cameras, camera_model, near_plane) -> None:
    """Raise ValueError where a lens has other coefficients than its model reads, or splats could lie behind it."""
    if near_plane < 0:
        raise ValueError(f"{near_plane=}, expected at least 0: splats are sorted by their depth in front of the camera")
    if radial_coeffs is None:
        return
    if camera_model != "fisheye":
        raise ValueError(f"radial_coeffs need camera_model='fisheye', not {camera_model!r}: undistort the photos")
    if radial_coeffs.shape != (num_cameras, 4):
        raise ValueError(f"{radial_coeffs.shape=}, expected {(num_cameras, 4)}")


def absgrad_zeros(absgrad, shape: tuple[int, ...]) -> Array | None:
    """The array whose gradient takes what gsplat writes to `means2d.absgrad`; None where that is not wanted.

    Raises:
        ValueError: It is True, which a function without side effects cannot answer to, or of another shape.
    """
    if absgrad is True or (absgrad is not False and absgrad is not None and absgrad.shape != shape):
        given = "True" if absgrad is True else f"[{', '.join(map(str, absgrad.shape))}]"
        raise ValueError(
            f"absgrad={given}: pass zeros of shape {shape}, whose gradient is what gsplat writes to means2d.absgrad"
        )
    return None if absgrad is False else absgrad


def check_counts(means, viewmats, colors) -> None:
    """Raise ValueError where there are not N Gaussians and C cameras, or there is no camera or no channel."""
    if means.ndim != 2:
        raise ValueError(f"{means.shape=}, expected [N, 3]")
    if viewmats.ndim != 3:
        raise ValueError(f"{viewmats.shape=}, expected [C, 4, 4]")
    if viewmats.shape[0] == 0:
        raise ValueError(f"{viewmats.shape=} holds no camera")
    if colors is not None and (colors.ndim == 0 or colors.shape[-1] == 0):
        raise ValueError(f"{colors.shape=} holds no channel")


def _check_shapes(means, quats, scales, covars, opacities, viewmats, Ks) -> None:
    num_gaussians, num_cameras = means.shape[0], viewmats.shape[0]
    expected = {
        "means": (means, (num_gaussians, 3)),
        "opacities": (opacities, (num_gaussians,)),
        "viewmats": (viewmats, (num_cameras, 4, 4)),
        "Ks": (Ks, (num_cameras, 3, 3)),
    }
    require_shape(quats, scales, covars)
    if covars is None:
        expected |= {"quats": (quats, (num_gaussians, 4)), "scales": (scales, (num_gaussians, 3))}
    else:
        expected["covars"] = (covars, (num_gaussians, 3, 3))
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            raise ValueError(f"{name}.shape={array.shape}, expected {shape} for {num_gaussians} Gaussians")


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


def check_arrays(
    means, quats, scales, covars, opacities, colors, viewmats, Ks, backgrounds, masks, sh_degree, render_mode
) -> None:
    """Raise ValueError where shapes do not fit each other, or masks are no truth values."""
    _check_shapes(means, quats, scales, covars, opacities, viewmats, Ks)
    num_gaussians, num_cameras = means.shape[0], viewmats.shape[0]
    _check_colors(colors, num_gaussians, num_cameras, sh_degree, render_mode)
    _check_backgrounds(backgrounds, colors, num_cameras, render_mode)
    if masks is not None and masks.dtype != jnp.bool_:
        raise ValueError(f"{masks.dtype=}, expected bool")


def check_masks(masks: Array | None, shape: tuple[int, int, int]) -> None:
    """Raise ValueError where the masks are not one per tile."""
    if masks is not None and masks.shape != shape:
        raise ValueError(f"{masks.shape=}, expected one per tile, {shape}")
