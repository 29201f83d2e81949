"""EWA projection: 3D Gaussians to 2D splats. Plain jnp, differentiated by JAX to any order.

Written in components, each one array over all cameras and Gaussians: XLA's CPU loops over rows of structs are ten times
slower.
"""

from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from rasterizer.camera_models import CameraModel, Lens
from rasterizer.covariances import (
    Matrix,
    Vector,
    camera_rows,
    components,
    dot,
    seen_from_axes,
    seen_from_triangle,
    tilt_from_axes,
    tilt_from_triangle,
    upper_triangle,
)
from rasterizer.rules import Rules
from rasterizer.tracing import walled

RasterizeMode = Literal["classic", "antialiased"]
DepthMode = Literal["center", "plane"]
"""What a splat's depth is at a pixel: that of its centre, or where along the pixel's ray the Gaussian is densest."""

SHOWN_SIGMAS = 3.33  # sqrt(2 ln 255): where a splat of opacity 1 falls under the alpha cut, standard deviations.


class Projection(NamedTuple):
    """Splats of C cameras and N Gaussians. Rows that are not `visible` hold harmless values."""

    means2d: Float[Array, "C N 2"]  # pixels
    depths: Float[Array, "C N"]  # camera z, scene units
    conics: Float[Array, "C N 3"]  # inverse 2D covariance (xx, xy, yy), 1 / pixels^2
    extents: Float[Array, "C N 2"]  # half width and height of what can pass the alpha cut, pixels; 0 where not visible
    visible: Bool[Array, "C N"]  # in front, finite, not too faint, inside the image
    compensations: Float[Array, "C N"] | None = None  # factor of the opacity that undoes the blur; None if classic
    slopes: Float[Array, "C N 2"] | None = None  # what depth gains per pixel along x and y; None: depth is the centre's


def camera_position(mean: Vector, viewmat: Matrix) -> Vector:
    """A world point in the camera's frame."""
    return [dot(viewmat[i], mean) + viewmat[i][3] for i in range(3)]


def _compensation(det: Array, blurred: Array, rules: Rules) -> Array:
    """What the blur spread a splat's energy by, undone: the root of the determinants' ratio (Mip-Splatting, eq. 9)."""
    ratio = det / blurred
    floor = rules.compensation_min**2
    return jnp.where(ratio > floor, jnp.sqrt(jnp.where(ratio > floor, ratio, 1)), rules.compensation_min)


def _within_reach(slope: Vector, tilt: Vector, room: Array) -> Vector:
    """The slope, made flatter where the splat would show depths beyond `room` from its centre's.

    Within k standard deviations of the splat, depth changes by k sqrt(slope . tilt) at most.
    """
    reach_squared = SHOWN_SIGMAS**2 * (slope[0] * tilt[0] + slope[1] * tilt[1])
    beyond = reach_squared > room * room
    flatter = jnp.where(beyond, room * jax.lax.rsqrt(jnp.where(beyond, reach_squared, 1)), 1)
    return [part * flatter for part in slope]


class Options(NamedTuple):
    """The static arguments of `rasterizer.project`."""

    model: CameraModel
    size: tuple[int, int]
    eps2d: float
    near_plane: float
    far_plane: float
    radius_clip: float
    rasterize_mode: RasterizeMode
    depth_mode: DepthMode
    rules: Rules


def _extents(mean2d: Vector, variances: Vector, opacity: Array, usable: Array, options: Options):
    """Half width and height of what can pass the alpha cut, 0 where not visible; and what is visible."""
    rules, sigmas = options.rules, options.rules.extent_sigmas
    if rules.opacity_extent:
        # alpha falls to alpha_min where exp(-s^2 / 2) = alpha_min / opacity.
        ratio = jnp.where(usable, opacity, 1) / rules.alpha_min
        sigmas = jnp.minimum(sigmas, jnp.sqrt(2 * jnp.log(jnp.maximum(ratio, 1))))
    extent, visible = [sigmas * jnp.sqrt(variance) for variance in variances], usable
    radii = [jnp.ceil(reach) for reach in extent]  # Whole pixels, as gsplat's are.
    if options.radius_clip > 0:
        visible &= (radii[0] > options.radius_clip) | (radii[1] > options.radius_clip)
    for center, radius, limit in zip(mean2d, radii, options.size, strict=True):
        visible &= (center + radius > 0) & (center - radius < limit)
    return [jnp.where(visible, reach, 0) for reach in extent], visible


def _project_components(
    mean: Vector, shape: tuple[Vector, ...], opacity: Array, viewmat: Matrix, lens: Lens, *, options: Options
) -> dict[str, Any]:
    """The fields of `Projection` by name, in components `[C, N]`.

    `shape` is quaternion and scales, or the upper triangle of a covariance.
    """
    model, size, eps2d, near_plane, far_plane, _, rasterize_mode, depth_mode, rules = options
    of_axes = len(shape) == 2
    image_covariance = seen_from_axes if of_axes else seen_from_triangle
    tilted = tilt_from_axes if of_axes else tilt_from_triangle
    harmless_shape = ((1, 0, 0, 0), (1, 1, 1)) if of_axes else ((1, 0, 0, 1, 0, 1),)

    def splat(mean, shape):
        x, y, z = camera_position(mean, viewmat)
        z_safe = jnp.where(z > near_plane, z, 1)
        mean2d, row_x, row_y = model.image_point([x, y, z_safe], viewmat, lens, size)
        rows = row_x, row_y
        xx, xy, yy, sharp = image_covariance(*rows, *shape)
        # det(S + eps 1) = det S + eps tr S + eps^2.
        xx, yy, det = xx + eps2d, yy + eps2d, sharp + eps2d * (xx + yy) + eps2d * eps2d
        # Divided by the root twice: the derivative of a plain division squares the determinant, which may overflow.
        inverse_root = jax.lax.rsqrt(jnp.where(det > 0, det, 1))
        conic = [part * inverse_root * inverse_root for part in (yy, -xy, xx)]
        slope = None
        if depth_mode == "plane":
            # The mean of z given the pixel: conic x cov((u, v), z), blurred; adj(S + eps 1) = adj S + eps 1.
            xz, yz, slope_x, slope_y = tilted(*rows, viewmat[2][:3], *shape)
            slope = [(part + eps2d * c) * inverse_root * inverse_root for part, c in ((slope_x, xz), (slope_y, yz))]
            slope = _within_reach(slope, [xz, yz], z_safe - near_plane)
        return mean2d, z, conic, slope, [xx, yy], det, sharp

    # First look, without gradient: whatever overflows or is not a number is swapped for a harmless Gaussian *before*
    # the differentiated computation, since 0 x inf in a backward pass would be NaN.
    mean2d, z, conic, slope, variances, det, _ = jax.lax.stop_gradient(splat(mean, shape))
    usable = (z > near_plane) & (z < far_plane) & (det > 0) & (variances[0] > 0) & (variances[1] > 0)
    usable &= opacity >= rules.alpha_min
    for part in (*mean, *sum(shape, []), opacity, *mean2d, *conic, *(slope or ()), *variances, z, det):
        usable &= jnp.isfinite(part)

    def where_usable(parts: Vector, harmless) -> Vector:
        return [jnp.where(usable, part, safe) for part, safe in zip(parts, harmless, strict=True)]

    # A point one unit in front of the camera: -R^T t + R^T e_z.
    ahead = [sum((at - viewmat[i][3]) * viewmat[i][j] for i, at in enumerate((0, 0, 1))) for j in range(3)]
    mean2d, z, conic, slope, variances, det, sharp = splat(
        where_usable(mean, jax.lax.stop_gradient(ahead)),
        tuple(where_usable(parts, safe) for parts, safe in zip(shape, harmless_shape, strict=True)),
    )
    compensation = None
    if rasterize_mode == "antialiased":
        compensation = _compensation(sharp, det, rules)
        opacity = opacity * compensation
        usable &= jax.lax.stop_gradient(opacity) >= rules.alpha_min
    extent, visible = _extents(*jax.lax.stop_gradient((mean2d, variances, opacity)), usable, options)
    parts = {"means2d": mean2d, "depths": z, "conics": conic, "extents": extent, "visible": visible}
    return parts | {"compensations": compensation, "slopes": slope}


_traced_once = jax.jit(_project_components, static_argnames="options")
"""The same; jax keeps its trace and derivatives, a fourth of what a program with a projection takes to compile."""


def project_in_jnp(
    options: Options,
    means: Array,
    quats: Array | None,
    scales: Array | None,
    opacities: Array,
    viewmats: Array,
    Ks: Array,
    covars: Array | None = None,
    radial_coeffs: Array | None = None,
) -> Projection:
    """`rasterizer.project`, its arguments alike in their mesh axes."""
    shapes = (quats, scales) if covars is None else (upper_triangle(covars),)
    inputs = (
        components(means[None]),
        tuple(components(jnp.expand_dims(shape, 0)) for shape in shapes),
        opacities[None],
        camera_rows(viewmats),
        Lens(camera_rows(Ks), None if radial_coeffs is None else [part[:, None] for part in components(radial_coeffs)]),
    )

    project_all = partial(_traced_once, options=options)
    # Recomputed on the way back: the inputs alone are kept in memory.
    parts = walled(jax.checkpoint(project_all), jnp.any(opacities >= options.rules.alpha_min), *inputs)
    # Stacked on this side of the wall.
    fields = {name: jnp.stack(part, -1) if isinstance(part, list) else part for name, part in parts.items()}
    return Projection(**fields)
