"""The paper's regulariser: gradients of the depth-based signed distance estimate, composited and aligned with normals.

Only first-order gradients of the rasterizer are ever needed: `jax.grad` of the estimate goes through the bilinear read
of the depth map, and the loss' own gradient through the renders of depth and of the gradient channels.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from gsjax import rendering
from gsjax.gaussians import Gaussians
from gsjax.numerics import dot, masked_mean, safe_normalize, times
from gsjax.rendering import View
from gsjax.rendering.sampling import reads_within, sample_bilinear
from gsjax.scene import cameras
from gsjax.scene.cameras import Camera

Estimator = Callable[[Gaussians, View, Camera], Array]
"""(Gaussians, View with depth, Camera) -> `[H, W, 3]` camera-frame direction per pixel, of any length."""

DOUBT = 0.1  # Misalignment, 1 - |cos|, from which on a pixel is doubted: 26 degrees.


def depth_sdf(
    point: Float[Array, "3"], depth: Float[Array, "{camera.height} {camera.width}"], camera: Camera
) -> Float[Array, ""]:
    """Estimated signed distance of one world point to the rendered surface: D(pi(p)) - z(p) (paper, section III).

    Args:
        point: World position.
        depth: Rendered depth, camera z in scene units.
        camera: The view that `depth` was rendered from.

    Returns:
        Scene units, positive between the camera and the surface. Its length of gradient is 1 / |n . ray|, not 1:
        only the direction is used. Differentiable to all arguments, finite also on and behind the camera plane.
    """
    point_cam = cameras.world_to_camera(point, camera)
    return sample_bilinear(depth, cameras.project(point_cam, camera)) - point_cam[2]


def sdf_gradient_map(gaussians: Gaussians, view: View, camera: Camera) -> Array:
    """`[H, W, 3]` the paper's estimator: jax.grad of `depth_sdf` at the visible means, composited by the rasterizer.

    A mean off the image, or next to a pixel without depth, has no slope to read: it adds no direction and no gradient.
    """
    assert view.depth is not None, "the estimate reads the rendered depth"
    reads = jax.vmap(reads_depth, in_axes=(0, None, None))(gaussians.means, view.depth > 0, camera)
    usable = (view.splats.projection.visible[0] & reads)[:, None]
    # What is not usable is read at a harmless place, so that nothing odd enters the gradient.
    points = jnp.where(usable, gaussians.means, jax.lax.stop_gradient(in_front(camera))[None])
    world = jax.vmap(jax.grad(depth_sdf), in_axes=(0, None, None))(points, view.depth, camera)
    in_camera = jax.vmap(partial(times, cameras.rotation(camera)))(jnp.where(usable, world, 0))
    position = jax.vmap(cameras.world_to_camera, in_axes=(0, None))(jax.lax.stop_gradient(gaussians.means), camera)
    return rendering.features(view.splats, face_camera(safe_normalize(in_camera), -position))[0]


def sdf_gradient(
    gaussians: Gaussians, camera: Camera, *, depth_mode: rendering.DepthReading = "plane", **options: Any
) -> Float[Array, "{camera.height} {camera.width} 3"]:
    """Gradients of the signed distance estimate, composited, in the camera's frame; of any length.

    Args:
        gaussians: The scene.
        camera: The view.
        depth_mode: What depth is, see `gsjax.rendering`.
        options: Further options of `gsjax.rendering`, such as `capacity`.

    Returns:
        The field that the paper's regulariser aligns with normals; zero where nothing is covered. Differentiable to
        the Gaussians and the camera, once.
    """
    view = rendering.render(gaussians, camera, with_depth=True, depth_mode=depth_mode, **options)
    return sdf_gradient_map(gaussians, view, camera)


def pixel_depth_map(gaussians: Gaussians, view: View, camera: Camera) -> Array:
    """`[H, W, 3]` the same gradient of the same estimate, taken at the surface point of every pixel: no compositing.

    By the chain rule it is the cross product of the depth map's central differences, unprojected.
    """
    del gaussians
    points = cameras.unproject(view.depth, camera)
    right = jnp.roll(points, -1, 1) - jnp.roll(points, 1, 1)
    down = jnp.roll(points, -1, 0) - jnp.roll(points, 1, 0)
    covered = jnp.pad(points[..., 2] > 0, 1)
    stencil = covered[1:-1, :-2] & covered[1:-1, 2:] & covered[:-2, 1:-1] & covered[2:, 1:-1]
    # Unit steps: a pixel's footprint in scene units is tiny, its square would pass for "too short to have a direction".
    right, down = (safe_normalize(step, eps=1e-24) for step in (right, down))
    return jnp.where(stencil[..., None], jnp.cross(down, right), 0)


def misalignment(directions: Array, normals: Array, valid: Array) -> Array:
    """The regulariser R: mean of 1 - |cos| over valid pixels, in [0, 1].

    The printed formula adds the sum of |cos|, whose minimum turns surfaces away from their normals; this is its
    complement (docs/deviations.md).

    Args:
        directions: `[H, W, 3]` composited SDF gradients, camera frame, any length.
        normals: `[H, W, 3]` monocular normals, camera frame; zero where there is none. A length under 1 is a
            confidence: the pixel counts by so much in the mean.
        valid: `[H, W]` bool, the pixels that may count.

    Returns:
        `[]`; its gradient is zero at both +n and -n, and zero where a direction is too short to have one.
    """
    return masked_mean(*misaligned(directions, normals, valid))


def doubted_misalignment(directions: Array, normals: Array, valid: Array) -> Array:
    """`misalignment` in which a pixel counts less, the farther off it is: e, and DOUBT (1 + log(e / DOUBT)) beyond.

    That is the least of w e - DOUBT log w over the pixel's confidence w, which is 1 up to DOUBT and DOUBT / e beyond
    (a confidence as in Kendall and Gal, 2017, for each pixel by itself). At an edge of depth, and where a splat shows
    what the photo's normal is not of, no step can help, and pulling at it costs pictures.
    """
    error, weight = misaligned(directions, normals, valid)
    far = error > DOUBT
    beyond = DOUBT * (1 + jnp.log(jnp.where(far, error, DOUBT) / DOUBT))
    return masked_mean(jnp.where(far, beyond, error), weight)


def misaligned(directions: Array, normals: Array, valid: Array) -> tuple[Array, Array]:
    """`[H, W]` 1 - |cos| of every pixel, and `[H, W]` how much it counts in a mean; arguments as `misalignment` has."""
    unit = safe_normalize(directions, eps=1e-6)
    target = safe_normalize(normals)
    usable = valid & (dot(unit, unit) > 0.5) & (dot(target, target) > 0.5)
    confidence = jnp.minimum(jnp.sqrt(jnp.maximum(dot(normals, normals), 1e-12)), 1)
    return 1 - jnp.abs(dot(unit, target)), jnp.where(usable, confidence, 0)


def face_camera(directions: Array, towards_camera: Array) -> Array:
    """Flip directions whose dot product with `towards_camera` is negative; the sign carries no gradient."""
    side = dot(*jax.lax.stop_gradient((directions, towards_camera)))
    return jnp.where(side[..., None] < 0, -directions, directions)


def reads_depth(point: Array, covered: Array, camera: Camera) -> Array:
    """`[]` bool: a world point projects between four pixel centres of the image, all of them `covered` `[H, W]`."""
    return reads_within(covered, cameras.project(cameras.world_to_camera(point, camera), camera))


def in_front(camera: Camera) -> Array:
    """`[3]` the world point one unit in front of the camera."""
    return cameras.center(camera) + cameras.rotation(camera)[2]
