"""What is blended: the channels that a call requests, and no others."""

from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int32

from rasterizer.arrays import takes_arrays
from rasterizer.camera_models import CAMERA_MODELS, CameraModelName
from rasterizer.covariances import camera_rows, components, dot, rotation
from rasterizer.ewa import Projection, camera_position
from rasterizer.harmonics import camera_directions, spherical_harmonics

RenderMode = Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"]


def num_channels(colors: Array, render_mode: RenderMode) -> int:
    """Channels of the image."""
    return (colors.shape[-1] if "RGB" in render_mode else 0) + (render_mode != "RGB")


def drawable(colors: Array, sh_degree: int | None) -> Array:
    """`[N]` whether all of a Gaussian's colours are finite: one NaN would spread to every pixel that it touches."""
    gaussian_axis = 1 if colors.ndim == 3 and sh_degree is None else 0
    return jnp.isfinite(colors).all([axis for axis in range(colors.ndim) if axis != gaussian_axis])


def image_features(
    means: Array,
    colors: Array,
    viewmats: Array,
    projection: Projection,
    depths: Array | None,
    sh_degree: int | None,
    render_mode: RenderMode,
) -> Array:
    """`[C, N, X]` channels of the image: colours (from harmonics where requested) and, last, those of `depths`."""
    num_cameras = viewmats.shape[0]
    parts = []
    if "RGB" in render_mode:
        if sh_degree is not None:
            dirs = camera_directions(means, viewmats)
            values = spherical_harmonics(sh_degree, dirs, colors[None], projection.visible)
            parts.append(jnp.maximum(values + 0.5, 0))
        else:
            colors = colors if colors.ndim == 3 else jnp.broadcast_to(colors[None], (num_cameras, *colors.shape))
            parts.append(jnp.where(projection.visible[..., None], colors, 0))
    if depths is not None:
        parts.append(depths)
    return jnp.concatenate(parts, -1)


def center_channels(projection: Projection) -> Array:
    """`[C, N, 1]` the centres' depths."""
    return jnp.where(projection.visible, projection.depths, 0)[..., None]


def depth_channels(projection: Projection, width: int, height: int) -> Float[Array, "C N 1"] | Float[Array, "C N 3"]:
    """What is blended for depth, whether it is the centres' or the planes': `blended_depth` reads it.

    Args:
        projection: Splats of C cameras.
        width: Image width in pixels. Static.
        height: Image height in pixels. Static.

    Returns:
        The centres' depths; or, where the projection has slopes, every splat's plane: its
        depth in the middle of the image, and the slopes. Zero where not visible. A sum of planes is a plane, so three
        channels carry what each pixel would else compute for each splat. Seen from the middle of the image they are
        small numbers, which keeps float32's digits: the error is a rounding of slope x half the image.
    """
    if projection.slopes is None:
        return center_channels(projection)
    (x, y), (slope_x, slope_y) = components(projection.means2d), components(projection.slopes)
    in_the_middle = projection.depths + (slope_x * (0.5 * width - x) + slope_y * (0.5 * height - y))
    planes = jnp.concatenate([in_the_middle[..., None], projection.slopes], -1)
    return jnp.where(projection.visible[..., None], planes, 0)


def blended_depth(channels: Float[Array, "C H W 1"] | Float[Array, "C H W 3"]) -> Float[Array, "C H W 1"]:
    """Depth of blended `depth_channels`, not divided by alpha."""
    if channels.shape[-1] == 1:
        return channels
    height, width = channels.shape[1:3]
    x, y = (jnp.arange(n, dtype=channels.dtype) - (0.5 * n - 0.5) for n in (width, height))
    return (channels[..., 0] + x[None, None, :] * channels[..., 1] + y[None, :, None] * channels[..., 2])[..., None]


def expected_depth(image: Array, alphas: Array) -> Array:
    """The image with its last channel divided by alpha: 0 at an empty pixel, without gradient."""
    covered = alphas > 0
    # The divisor is made safe first.
    depth = jnp.where(covered, image[..., -1:] / jnp.where(covered, alphas, 1), 0)
    return jnp.concatenate([image[..., :-1], depth], -1)


def median_depth(projection: Projection, median: Int32[Array, "C H W"]) -> Float[Array, "C H W 1"]:
    """Depth of each pixel's median splat, 0 where there is none; differentiable to the projection."""
    p, has_median = projection, median >= 0
    if p.depths.size == 0:
        return jnp.zeros((*median.shape, 1), p.depths.dtype)
    index = jnp.maximum(median, 0)
    depth = p.depths.reshape(-1)[index]
    if p.slopes is not None:
        _, height, width = median.shape
        y, x = jnp.meshgrid(*(jnp.arange(n, dtype=depth.dtype) + 0.5 for n in (height, width)), indexing="ij")
        slope, mean2d = (part.reshape(-1, 2)[index] for part in (p.slopes, p.means2d))
        depth = depth + jnp.sum(slope * (jnp.stack([x, y], -1)[None] - mean2d), -1)
    return jnp.where(has_median, depth, 0)[..., None]


@takes_arrays
def camera_normals(
    means: Float[Array, "N 3"],
    quats: Float[Array, "N 4"],
    scales: Float[Array, "N 3"],
    viewmats: Float[Array, "C 4 4"],
    visible: Bool[Array, "C N"],
    camera_model: CameraModelName = "pinhole",
) -> Float[Array, "C N 3"]:
    """Unit normals of N Gaussians in C camera frames (OpenCV axes): their smallest axes, turned towards the camera.

    Args:
        means: World positions; they only decide the sign.
        quats: Rotations (w, x, y, z) of any length.
        scales: They only decide which axis is the smallest.
        viewmats: World to camera.
        visible: Where it is False the normal is zero, with zero gradient, whatever the Gaussian holds.
        camera_model: Decides which way a Gaussian is seen from, and so the sign. Static.

    Returns:
        Normals, differentiable to quats and viewmats.
    """
    # What no camera sees is made harmless first; what one camera sees is sound.
    in_any_view = visible.any(0)[:, None]
    quats = jnp.where(in_any_view, quats, jnp.array([1, 0, 0, 0], quats.dtype))
    means = jax.lax.stop_gradient(jnp.where(in_any_view, means, 0))
    smallest = jnp.argmin(jnp.where(in_any_view, scales, 1), axis=-1)
    axis = [
        jnp.where(smallest == 0, x, jnp.where(smallest == 1, y, z)) for x, y, z in rotation(components(quats[None]))
    ]
    viewmat = camera_rows(viewmats)
    in_camera = [dot(viewmat[i], axis) for i in range(3)]
    ray = CAMERA_MODELS[camera_model].ray(camera_position(components(means[None]), viewmat))
    away = jax.lax.stop_gradient(dot(in_camera, ray)) > 0
    return jnp.stack([jnp.where(visible, jnp.where(away, -part, part), 0) for part in in_camera], -1)
