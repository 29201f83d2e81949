"""Gaussians and a camera to one view: colours over a background, coverage, depth and what else is requested."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int32, Shaped

import rasterizer
from gsjax.numerics import safe_normalize
from gsjax.rendering.depth import IN_FRONT, DepthReading, depth_channels, mean_depth, splat_depth_mode, summed_depth
from gsjax.rendering.splats import Drawable, Splats, facing_axes, features, in_one_dtype, splat
from gsjax.scene import cameras
from gsjax.scene.cameras import Camera


class Neighbor(NamedTuple):
    """What another camera sees of the same scene, as far as a term compares it with a view."""

    camera: Camera
    depth: Float[Array, "H W"]  # as in `View`
    pairs: rasterizer.TilePairs
    image: Float[Array, "H W 3"] | None = None  # its photo, 0..1, over the background
    valid: Bool[Array, "H W"] | None = None  # of the photo


class BoundMesh(NamedTuple):
    """The mesh that Gaussians are bound to, as a term reads it."""

    vertices: Float[Array, "V 3"]  # world, scene units
    faces: Int32[Array, "F 3"]  # vertex ids, counter-clockwise seen from outside
    face_pairs: Int32[Array, "P 2"]  # faces with a common edge


class View(NamedTuple):
    """What one view shows. A field that was not requested is None."""

    colors: Float[Array, "H W 3"]  # over the background, not clamped
    alphas: Float[Array, "H W"]  # coverage: the sum of the blending weights
    depth: Float[Array, "H W"] | None  # mean camera z, of all splats or those in front; 0 where alpha < `MIN_COVERAGE`
    splats: Splats  # projection, opacities and lists of the view
    extra: Float[Array, "H W D"] | None = None  # what `extra` composites to, on zero
    probes: Float[Array, "H W K"] | None = None  # zeros, whose gradient goes to the argument `probes`
    axes: Float[Array, "H W 3"] | None = None  # what the splats' smallest axes composite to (`facing_axes`), on zero
    neighbor: Neighbor | None = None  # only in a step whose loss has a term between two views
    raw_depth: Float[Array, "H W"] | None = None  # `depth` before it is divided by the coverage: the weighted sum
    mesh: BoundMesh | None = None  # only in a refinement

    @property
    def normals(self) -> Float[Array, "H W 3"]:
        """Unit normals in the camera's frame, of `axes`; zero where there are none. Needs `with_axes=True`."""
        if self.axes is None:
            raise ValueError("normals are of the composited axes: render(..., with_axes=True)")
        return safe_normalize(self.axes)


def render(
    gaussians: Any,
    camera: Camera,
    *,
    capacity: int | None = None,
    background: Float[Array, "3"] | Float[Array, "{camera.height} {camera.width} 3"] | None = None,
    active_degree: Shaped[Array, ""] | Shaped[Array, "N"] | int | None = None,
    with_depth: bool = False,
    depth_mode: DepthReading = "plane",
    means2d_probe: Float[Array, "N 2"] | None = None,
    extra: Float[Array, "N D"] | None = None,
    probes: Float[Array, "N K"] | None = None,
    with_axes: bool = False,
    backend: rasterizer.Backend = "auto",
) -> View:
    """Render one view. Differentiable to the Gaussians, the camera matrices and the background.

    Arrays of another dtype than float32 are cast, and their gradients have the dtype of the caller's arrays. Only the
    reference computes in float64.

    Args:
        gaussians: The scene, of any kind that `drawable` knows.
        camera: The view.
        capacity: See `splat`.
        background: Colour under the image, one for all pixels or one for each. None: black.
        active_degree: Highest SH degree used, one for all Gaussians or one for each; may be traced. None: all.
        with_depth: Whether `depth` and `raw_depth` are composited too. Static; not in the program otherwise.
        depth_mode: What a splat's depth is: "plane" where the Gaussian is densest along each pixel's ray, "center" that
            of its mean; depth is the mean over the splats. "front": the mean of the planes of those in front, see
            `IN_FRONT`; "discs": the same of discs on a mesh. Static.
        means2d_probe: See `splat`.
        extra: Further channels, composited on zero.
        probes: Channels of zeros, for their gradient: the sum over pixels of blending weights times the cotangent of
            `View.probes`.
        with_axes: Whether `axes` and `normals` are composited too, for a scene that has `quats` and `scales`. Static;
            not in the program otherwise.
        backend: As in `rasterizer.rasterization`; "reference" has forward mode and derivatives of any order. Static.

    Returns:
        `View`.

    Raises:
        TypeError: In forward mode, or differentiated a second time, unless the backend is "reference".
    """
    scene, camera = in_one_dtype(gaussians, camera, backend)
    reading = depth_mode if with_depth else None
    splats = splat(scene, camera, capacity, means2d_probe, splat_depth_mode(reading), backend)
    axes = facing_axes(scene, camera, splats.projection) if with_axes else None
    splat_colors = colors(scene, camera, active_degree, backend)
    under = jnp.zeros(3, splat_colors.dtype) if background is None else background
    return view_splats(splats, splat_colors, under, reading=reading, extra=extra, probes=probes, axes=axes)


def view_splats(
    splats: Splats,
    colors: Array,
    background: Array,
    *,
    reading: DepthReading | None = None,
    extra: Array | None = None,
    probes: Array | None = None,
    axes: Array | None = None,
) -> View:
    """What splats of `[N, 3]` colours show, and their depth if it is read: all in one pass.

    `axes` are those of `facing_axes`; the rest is as in `view`.
    """
    # Depth comes last of the channels: that is where the pass looks for what is in front. Probes are behind all.
    planes = None if reading is None else depth_channels(splats, reading)
    channels = {"colors": colors, "extra": extra, "axes": axes, "depth": planes}
    channels = {name: jnp.asarray(values, colors.dtype) for name, values in channels.items() if values is not None}
    image, alphas = features(splats, jnp.concatenate(list(channels.values()), -1), IN_FRONT.get(reading), probes)
    ends = np.cumsum([values.shape[1] for values in channels.values()]).tolist()
    composited = dict(zip([*channels, "probes"], jnp.split(image, ends, axis=-1), strict=True))
    background = jnp.asarray(background, image.dtype)
    under = background if background.ndim == 3 else background[None, None]
    over = composited["colors"] + (1 - alphas)[..., None] * under
    raw_depth = depth = None
    if reading is not None:
        raw_depth, weights = summed_depth(composited["depth"], alphas, reading)
        depth = mean_depth(raw_depth, weights)
    zeros = None if probes is None else composited["probes"]
    return View(over, alphas, depth, splats, composited.get("extra"), zeros, composited.get("axes"), None, raw_depth)


def colors(
    scene: Drawable,
    camera: Camera,
    active_degree: Array | int | None = None,
    backend: rasterizer.Backend = "auto",
) -> Array:
    """`[N, 3]` colour of every Gaussian seen from the camera, at least 0 (3DGS: max(0, SH + 0.5)).

    `active_degree`, one for all or `[N]`, may be traced: bands above it are multiplied by zero, so a ramp never
    recompiles. `backend` is as in `render`.
    """
    directions, active_bands = scene.means - cameras.center(camera)[None], None
    if active_degree is not None:
        band = jnp.floor(jnp.sqrt(jnp.arange(1, 1 + scene.sh_rest.shape[1], dtype=jnp.float32)))
        active_bands = (band[None] <= jnp.asarray(active_degree, jnp.float32).reshape(-1, 1)).astype(directions.dtype)
    bands = rasterizer.spherical_harmonics_l0(scene.sh_dc) + rasterizer.upper_bands(
        directions, scene.sh_rest, active_bands, backend=backend
    )
    return jnp.maximum(bands + 0.5, 0)
