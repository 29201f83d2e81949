"""EWA projection: 3D Gaussians to 2D splats. Plain jnp, differentiated by JAX to any order.

One Gaussian and one camera per function, `vmap`ped at the public boundary; the 3x3 algebra is written out, so that no
matrix unit ever rounds a pose or a covariance.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from rasterizer.rules import GSPLAT, Rules


class Projection(NamedTuple):
    """Splats of C cameras and N Gaussians. Rows that are not `visible` hold harmless values."""

    means2d: Array  # [C, N, 2] pixels
    depths: Array  # [C, N] camera z, scene units
    conics: Array  # [C, N, 3] inverse 2D covariance (xx, xy, yy), 1 / pixels^2
    extents: Array  # [C, N, 2] half width and height of what can pass the alpha cut, pixels; 0 where not visible
    visible: Array  # [C, N] bool: in front, finite, not too faint, inside the image


def _rotation(quat: Array) -> list[list[Array]]:
    """Rotation matrix of a quaternion (w, x, y, z) of any length; zero gives the identity with zero gradient."""
    # Divided by its largest entry first: the square of a long one would overflow.
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(quat)))
    is_zero = largest < 1e-12
    quat = quat / jnp.where(is_zero, 1, largest)
    unit = quat * jax.lax.rsqrt(jnp.where(is_zero, 1, jnp.sum(quat * quat)))
    w, x, y, z = jnp.where(is_zero, jnp.array([1, 0, 0, 0], quat.dtype), unit)
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def _dot(a: list[Array], b: list[Array]) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _camera_position(mean: Array, viewmat: Array) -> list[Array]:
    return [_dot(list(viewmat[i, :3]), list(mean)) + viewmat[i, 3] for i in range(3)]


def _image_axes(point: list[Array], quat: Array, scale: Array, viewmat: Array, K: Array, size: tuple[int, int]):
    """Rows of J W R S: the Gaussian's axes in the image, [2][3] pixels. Their Gram matrix is the 2D covariance."""
    x, y, z = point
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    width, height = size
    # The affine approximation explodes far outside the image: it is taken at most 30 % of half a field of view out.
    slope_x = jnp.clip(x / z, -cx / fx - 0.15 * width / fx, (width - cx) / fx + 0.15 * width / fx)
    slope_y = jnp.clip(y / z, -cy / fy - 0.15 * height / fy, (height - cy) / fy + 0.15 * height / fy)
    axes = _rotation(quat)
    in_camera = [
        [_dot(list(viewmat[i, :3]), [axes[k][j] for k in range(3)]) * scale[j] for j in range(3)] for i in range(3)
    ]
    row_x = [fx / z * (in_camera[0][j] - slope_x * in_camera[2][j]) for j in range(3)]
    row_y = [fy / z * (in_camera[1][j] - slope_y * in_camera[2][j]) for j in range(3)]
    return row_x, row_y


def _covariance(row_x: list[Array], row_y: list[Array], eps2d: float) -> tuple[Array, Array, Array, Array]:
    """(xx, xy, yy, determinant) of the blurred 2D covariance.

    The determinant is |row_x x row_y|^2 + eps tr + eps^2 (Lagrange's identity): a sum of squares, so a needle of any
    aspect keeps a positive one, where xx yy - xy^2 cancels to noise in float32.
    """
    xx, xy, yy = _dot(row_x, row_x), _dot(row_x, row_y), _dot(row_y, row_y)
    cross = [row_x[(i + 1) % 3] * row_y[(i + 2) % 3] - row_x[(i + 2) % 3] * row_y[(i + 1) % 3] for i in range(3)]
    return xx + eps2d, xy, yy + eps2d, _dot(cross, cross) + eps2d * (xx + yy) + eps2d * eps2d


def _project_one(
    mean: Array,
    quat: Array,
    scale: Array,
    opacity: Array,
    viewmat: Array,
    K: Array,
    size: tuple[int, int],
    eps2d: float,
    near_plane: float,
    far_plane: float,
    rules: Rules,
) -> Projection:
    def splat(mean, quat, scale):
        x, y, z = _camera_position(mean, viewmat)
        z_safe = jnp.where(z > near_plane, z, 1)
        xx, xy, yy, det = _covariance(*_image_axes([x, y, z_safe], quat, scale, viewmat, K, size), eps2d)
        # Divided by the root twice: the derivative of a plain division squares the determinant, which may overflow.
        inverse_root = jax.lax.rsqrt(jnp.where(det > 0, det, 1))
        mean2d = jnp.stack([K[0, 0] * x / z_safe + K[0, 2], K[1, 1] * y / z_safe + K[1, 2]])
        return mean2d, z, jnp.stack([yy, -xy, xx]) * inverse_root * inverse_root, jnp.stack([xx, yy]), det

    # First look, without gradient: whatever overflows or is not a number is swapped for a harmless Gaussian *before*
    # the differentiated computation, since 0 x inf in a backward pass would be NaN.
    mean2d, z, conic, variances, det = jax.lax.stop_gradient(splat(mean, quat, scale))
    finite = jnp.isfinite(jnp.concatenate([mean2d, conic, variances, jnp.stack([z, det, opacity])])).all()
    finite &= jnp.isfinite(mean).all() & jnp.isfinite(quat).all()
    usable = finite & (z > near_plane) & (z < far_plane) & (det > 0) & (opacity >= rules.alpha_min)
    # A point one unit in front of the camera: -R^T t + R^T e_z.
    harmless = (jnp.array([0, 0, 1], mean.dtype) - viewmat[:3, 3])[:, None] * viewmat[:3, :3]
    mean2d, z, conic, variances, det = splat(
        jnp.where(usable, mean, jax.lax.stop_gradient(harmless.sum(0))),
        jnp.where(usable, quat, jnp.array([1, 0, 0, 0], quat.dtype)),
        jnp.where(usable, scale, jnp.ones_like(scale)),
    )
    sigmas = rules.extent_sigmas
    if rules.opacity_extent:
        # alpha falls to alpha_min where exp(-s^2 / 2) = alpha_min / opacity.
        ratio = jnp.where(usable, opacity, 1) / rules.alpha_min
        sigmas = jnp.minimum(sigmas, jnp.sqrt(2 * jnp.log(jnp.maximum(ratio, 1))))
    extent = jax.lax.stop_gradient(sigmas * jnp.sqrt(variances))
    center = jax.lax.stop_gradient(mean2d)
    inside = (center + extent > 0).all() & (center - extent < jnp.array(size, mean.dtype)).all()
    visible = usable & inside
    return Projection(mean2d, z, conic, jnp.where(visible, extent, 0), visible)


def project(
    means: Array,
    quats: Array,
    scales: Array,
    opacities: Array,
    viewmats: Array,
    Ks: Array,
    width: int,
    height: int,
    *,
    eps2d: float = 0.3,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    rules: Rules = GSPLAT,
) -> Projection:
    """Project N Gaussians into C cameras (EWA splatting; conventions of gsplat 1.6).

    Args:
        means: `[N, 3]` world positions.
        quats: `[N, 4]` rotations (w, x, y, z) of any length.
        scales: `[N, 3]` standard deviations, linear.
        opacities: `[N]` in 0..1; they only decide extents and visibility here, and receive no gradient.
        viewmats: `[C, 4, 4]` world to camera, OpenCV axes.
        Ks: `[C, 3, 3]` pixels.
        width: Image width in pixels. Static.
        height: Image height in pixels. Static.
        eps2d: Added to both variances of the 2D covariance, pixels^2.
        near_plane: Gaussians at or nearer than this camera z are culled.
        far_plane: Gaussians at or beyond this camera z are culled.
        rules: Decides extents and the opacity below which nothing shows.

    Returns:
        `Projection`; `means2d`, `depths` and `conics` are differentiable to means, quats, scales, viewmats and Ks.
    """
    one_camera = jax.vmap(
        lambda m, q, s, o, v, k: _project_one(m, q, s, o, v, k, (width, height), eps2d, near_plane, far_plane, rules),
        in_axes=(0, 0, 0, 0, None, None),
    )
    return jax.vmap(one_camera, in_axes=(None, None, None, None, 0, 0))(means, quats, scales, opacities, viewmats, Ks)
