"""A mesh that is edited takes its Gaussians along."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from gsjax.binding.bound import COLLAPSED, LAYOUTS, BoundGaussians, axes, bind, means, unit_turns
from gsjax.binding.mixed_gaussians import MixedGaussians, with_free
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, rotation_matrices, take
from gsjax.scene.meshes import Mesh
from rasterizer.covariances import components

MOST_APART = 1e-4  # Of the mesh's size: a Gaussian farther than this from its place on the mesh is another's.


def rebound(mesh: Mesh, gaussians: Gaussians) -> MixedGaussians:
    """The scene of which `gsjax.binding.bound.to_mesh` and `gsjax.binding.mixed_gaussians.all_gaussians` made these.

    The bound ones are first and are all equally thick, to the bit; from the first that is not, they are free. The
    vertices and faces are in the order in which they were written, as are the Gaussians.

    Raises:
        InputError: The Gaussians are not those of the mesh.
    """
    is_free = gaussians.log_scales[:, 0] != gaussians.log_scales[:1, 0]
    count, faces = int(np.argmax(np.append(is_free, True))), mesh.num_faces
    if not faces or count % faces or count // faces not in LAYOUTS:
        raise InputError(f"{count} Gaussians are not 1, 3, 4 or 6 to each of {faces} triangles")
    gaussians, free = take(gaussians, slice(count)), take(gaussians, slice(count, None))
    thickness = float(np.exp(gaussians.log_scales[0, 0]))
    plain = bind(
        mesh, per_triangle=count // faces, thickness=thickness, sh_degree=0, pixel_filter=gaussians.pixel_filter
    )
    apart = np.linalg.norm(np.asarray(means(plain)) - gaussians.means, axis=-1).max()
    size = np.ptp(mesh.vertices, axis=0).max()
    if apart > MOST_APART * size:
        raise InputError(f"the Gaussians are not those of the mesh: one is {apart:.3g} units from its place there")
    frames, first = axes(plain), rotation_matrices(jnp.asarray(gaussians.quats))[:, :, 1]
    bound = replace(
        plain,
        log_scales=jnp.asarray(gaussians.log_scales[:, 1:]),
        rotations=jnp.stack([jnp.sum(first * frames[:, :, axis], axis=-1) for axis in (1, 2)], axis=-1),
        logit_opacities=jnp.asarray(gaussians.logit_opacities),
        sh_dc=jnp.asarray(gaussians.sh_dc),
        sh_rest=jnp.asarray(gaussians.sh_rest),
    )
    return with_free(bound, free)


def with_vertices(bound: BoundGaussians, vertices: np.ndarray) -> BoundGaussians:
    """The Gaussians after the vertices were moved, to `[V, 3]`: each is stretched and turned as its triangle is.

    Means and normals follow the vertices by themselves. The in-plane covariance S of a Gaussian becomes J S J^T, J
    being the map that takes the old triangle to the new one, so a rigid motion or a scaling of the whole mesh moves
    all but the thickness exactly. Gaussians of a triangle that was or becomes collapsed keep their shape.

    Raises:
        ValueError: Another number of vertices.
    """
    vertices = np.asarray(vertices, np.float64)
    if vertices.shape != bound.vertices.shape:
        raise ValueError(f"vertices of shape {vertices.shape} for a mesh of {bound.vertices.shape}")
    before, after = (_flat_triangles(v, np.asarray(bound.faces)) for v in (np.asarray(bound.vertices), vertices))
    usable = _is_usable(before) & _is_usable(after)
    stretch = np.tile(np.eye(2), (len(before), 1, 1))
    stretch[usable] = after[usable] @ np.linalg.inv(before[usable])

    re, im = (np.asarray(part, np.float64) for part in unit_turns(components(bound.rotations)))
    roots = np.stack([np.stack([re, -im], -1), np.stack([im, re], -1)], -2) * np.exp(bound.log_scales)[:, None, :]
    turned, scales, _ = np.linalg.svd(np.repeat(stretch, bound.per_triangle, axis=0) @ roots)
    return replace(
        bound,
        vertices=jnp.asarray(vertices, jnp.float32),
        log_scales=jnp.asarray(np.log(np.maximum(scales, 1e-12)), jnp.float32),
        rotations=jnp.asarray(turned[:, :, 0], jnp.float32),
    )


def _flat_triangles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """`[F, 2, 2]` two edges of each triangle (columns) in its plane's axes, chosen as in `gsjax.binding.bound`."""
    a, b, c = np.moveaxis(vertices.astype(np.float64)[faces], 1, 0)
    along, other = a - b, c - b
    length = np.linalg.norm(along, axis=-1)
    safe = np.where(length > 0, length, 1)
    run = np.sum(other * along, axis=-1) / safe
    height = -np.linalg.norm(np.cross(other, along), axis=-1) / safe
    return np.stack([np.stack([length, run], -1), np.stack([np.zeros_like(length), height], -1)], -2)


def _is_usable(triangles: np.ndarray) -> np.ndarray:
    size = np.abs(triangles).max(axis=(1, 2))
    return np.abs(np.linalg.det(triangles)) > COLLAPSED * size**2
