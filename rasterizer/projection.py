"""Gaussians to splats: the front door of the projection, in jnp or in a CPU's native loops."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from rasterizer.arrays import takes_arrays
from rasterizer.camera_models import CAMERA_MODELS, CameraModelName
from rasterizer.engines import Backend, load_loops, native_loops
from rasterizer.ewa import DepthMode, Options, Projection, RasterizeMode, project_in_jnp
from rasterizer.rules import GSPLAT, Rules
from rasterizer.tracing import reverse_only, vary_alike


def require_shape(quats: Array | None, scales: Array | None, covars: Array | None) -> None:
    """Raise ValueError where nothing says what shape the Gaussians have."""
    if covars is None and (quats is None or scales is None):
        raise ValueError("a Gaussian's shape is missing: pass quats and scales, or covars")


@takes_arrays
def project(
    means: Float[Array, "N 3"],
    quats: Float[Array, "N 4"] | None,
    scales: Float[Array, "N 3"] | None,
    opacities: Float[Array, "N"],
    viewmats: Float[Array, "C 4 4"],
    Ks: Float[Array, "C 3 3"],
    width: int,
    height: int,
    *,
    covars: Float[Array, "N 3 3"] | None = None,
    eps2d: float = 0.3,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    rasterize_mode: RasterizeMode = "classic",
    depth_mode: DepthMode = "center",
    camera_model: CameraModelName = "pinhole",
    radial_coeffs: Float[Array, "C 4"] | None = None,
    rules: Rules = GSPLAT,
    backend: Backend = "auto",
) -> Projection:
    """Project N Gaussians into C cameras (EWA splatting; conventions of gsplat 1.6).

    Args:
        means: World positions.
        quats: Rotations (w, x, y, z) of any length; unused with `covars`.
        scales: Standard deviations, linear; unused with `covars`.
        opacities: In 0..1; they only decide extents and visibility here, and receive no gradient.
        viewmats: World to camera, OpenCV axes.
        Ks: Pixels.
        width: Image width in pixels. Static.
        height: Image height in pixels. Static.
        covars: Symmetric covariances in place of quats and scales, upper triangle read. A needle of
            aspect a loses a^2 of float32's digits here, and nothing from quats and scales.
        eps2d: Added to both variances of the 2D covariance, pixels^2.
        near_plane: Gaussians at or nearer than this camera z are culled.
        far_plane: Gaussians at or beyond this camera z are culled.
        radius_clip: Gaussians whose extents, rounded up to whole pixels, are both at most this are culled.
        rasterize_mode: "antialiased" also computes `compensations`, and sizes extents by the compensated opacity.
        depth_mode: "plane" also computes `slopes`: at a pixel u a splat's depth is `depths + slopes . (u - means2d)`,
            the mean of camera z given u under the linearised camera, blur included. Wherever the splat can pass an
            alpha cut of 1/255 that is within 3.33 standard deviations of its centre's depth, and not behind
            `near_plane`: a steeper plane is made flatter.
        camera_model: How a point comes into the image: "pinhole"; "ortho", a parallel projection with `fx`, `fy` in
            pixels per scene unit; "fisheye", equidistant. Depth is camera z with all. Static.
        radial_coeffs: k1 to k4 of the fisheye lens (Kannala and Brandt; OpenCV's order); None for zeros.
        rules: Decides extents and the opacity below which nothing shows.
        backend: "native" is the loops of a CPU, for float32, quats and scales, and pinhole cameras. Static.

    Returns:
        `Projection`; `means2d`, `depths`, `conics`, `compensations` and `slopes` are differentiable to means, quats,
        scales, covars, viewmats, Ks and radial_coeffs; with the loops by `jax.grad` and `jax.vjp` alone, once.

    Raises:
        ValueError: There are neither quats and scales nor covars.
        TypeError: On what is no array.
    """
    require_shape(quats, scales, covars)
    arrays = means, quats, scales, opacities, viewmats, Ks, covars, radial_coeffs
    means, quats, scales, opacities, viewmats, Ks, covars, radial_coeffs = vary_alike(arrays)
    options = Options(
        CAMERA_MODELS[camera_model],
        (width, height),
        float(eps2d),
        float(near_plane),
        float(far_plane),
        float(radius_clip),
        rasterize_mode,
        depth_mode,
        rules,
    )
    axes = means, quats, scales, opacities, viewmats, Ks
    is_single = all(each is not None and each.dtype == jnp.float32 for each in axes)
    if covars is None and camera_model == "pinhole" and native_loops(backend) and is_single:
        return _in_loops(options, *map(reverse_only, axes))
    return project_in_jnp(options, *axes, covars, radial_coeffs)


def _numbers(options: Options) -> Array:
    """What the loops read of the options."""
    rules = options.rules
    thresholds = options.eps2d, options.near_plane, options.far_plane, options.radius_clip
    switches = options.rasterize_mode == "antialiased", options.depth_mode == "plane", rules.opacity_extent
    cuts = rules.alpha_min, rules.compensation_min, rules.extent_sigmas
    return jnp.asarray(np.array([*options.size, *thresholds, *cuts, *switches], np.float32))


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _in_loops(options: Options, *arrays: Array) -> Projection:
    with_factors, with_slopes = options.rasterize_mode == "antialiased", options.depth_mode == "plane"
    pair, one, three = ((arrays[4].shape[0], arrays[0].shape[0], *width) for width in ((2,), (), (3,)))
    shapes = pair, one, three, one if with_factors else (0,), pair if with_slopes else (0,), pair
    results = [*(jax.ShapeDtypeStruct(shape, np.float32) for shape in shapes), jax.ShapeDtypeStruct(one, bool)]
    parts = load_loops().call("project", results, *arrays, _numbers(options))
    means2d, depths, conics, factors, slopes, extents, visible = parts
    factors, slopes = factors if with_factors else None, slopes if with_slopes else None
    return Projection(means2d, depths, conics, extents, visible, factors, slopes)


def _in_loops_bwd(options: Options, arrays: tuple[Array, ...], cotangents: Projection):
    *gaussians, viewmats, Ks = arrays
    parts = cotangents.means2d, cotangents.depths, cotangents.conics, cotangents.compensations, cotangents.slopes
    parts = [jnp.zeros(0, jnp.float32) if part is None else part for part in parts]
    gradients = load_loops().call("project_gradient", arrays[:3], *arrays, _numbers(options), *parts)
    # XLA leaves this out where no gradient to the cameras is used.
    of_cameras = jax.vjp(lambda *cameras: project_in_jnp(options, *gaussians, *cameras), viewmats, Ks)[1]
    return *gradients, jnp.zeros_like(gaussians[3]), *of_cameras(cotangents)


_in_loops.defvjp(lambda options, *arrays: (_in_loops(options, *arrays), arrays), _in_loops_bwd)
