"""A texture from rendered views: every texel gets the mean of what the views that see it show there."""

import math
from collections.abc import Callable, Iterable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy import ndimage

from gsjax.meshing.atlas import Atlas, TexturedMesh, unwrap
from gsjax.meshing.pictures import depth_of_mesh
from gsjax.meshing.ray_queries import ray_caster
from gsjax.meshing.texel_points import Texels, paint_texture, texels_of
from gsjax.rendering import MIN_COVERAGE
from gsjax.rendering.backdrop import color_behind
from gsjax.rendering.gallery import Picture
from gsjax.scene import cameras as pinhole
from gsjax.scene.cameras import Camera, viewmat_center
from gsjax.scene.colors import to_bytes
from gsjax.scene.meshes import Mesh, face_normals

TEXELS_AT_ONCE = 1 << 18
MIN_COSINE = 0.2  # A view flatter than this (78 degrees off the normal) says nothing of a texel.
DEPTH_SLACK = 2e-3  # Share of its depth by which a texel may differ from the mesh's depth at a pixel and be seen there,
PIXEL_SLACK = 2.0  # and pixels along which the surface's slope is followed.
RENDERED_SLACK = 0.1  # Share of its depth by which what the Gaussians show may float before a texel.


def texture_mesh(
    mesh: Mesh,
    cameras: Sequence[Camera],
    pictures: Iterable[Picture],
    *,
    size: int = 4096,
    background: np.ndarray | None = None,
    unwrap: Callable[[Mesh, int], Atlas] = unwrap,
) -> tuple[TexturedMesh, dict]:
    """Paints a mesh with what its views show.

    Memory: about 40 bytes a texel and 400 a triangle, one picture at a time.

    Args:
        mesh: Outward triangles. Its vertex colours remain where no view sees the surface.
        cameras: One camera a view.
        pictures: What each of them sees, over black (colours times coverage); a generator will do.
        size: Side of the texture, texels.
        background: What was behind the Gaussians in training, see `gsjax.rendering.backdrop`: a white wall before
            a white background may be thin, and what shines through it is its own colour. None: nothing is known of it,
            and a thin wall has the colour of its Gaussians alone.
        unwrap: How the mesh is laid out.

    Returns:
        The mesh with its texture, and a report: `charts`, `texels` on the surface, `seen_share` of them.

    Raises:
        InputError: The texture has no room for so many triangles.
    """
    atlas = unwrap(mesh, size)
    texels = texels_of(mesh, atlas)
    colors, is_seen = composite_views(mesh, texels, cameras, pictures, background)
    texture = paint_texture(texels, np.where(is_seen[:, None], colors, texels.colors), size)
    report = {"charts": atlas.num_charts, "texels": len(texels.where), "seen_share": float(np.mean(is_seen))}
    return TexturedMesh(mesh, atlas, texture), report


def composite_views(
    mesh: Mesh,
    texels: Texels,
    cameras: Sequence[Camera],
    pictures: Iterable[Picture],
    background: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """`[M, 3]` uint8 weighted means over the views, and `[M]` whether any view sees the texel.

    A view's weight is the number of its pixels that a unit of surface covers: near and frontal views count most.
    Running sums are kept, so that memory does not grow with the number of views.
    """
    cast, normals = ray_caster(mesh), face_normals(mesh).astype(np.float32)
    sums = np.zeros((len(texels.where), 4), np.float32)
    for camera, picture in zip(cameras, pictures, strict=True):
        depth = depth_of_mesh(cast, camera)
        colors, alphas = filled_in(picture, camera, depth > 0, background)
        # Nothing rendered is no haze.
        rendered = np.where(picture.depth > 0, picture.depth, np.inf)
        layers = np.dstack([colors, alphas, depth, rendered]).astype(np.float32)
        candidates = np.flatnonzero(may_be_seen(mesh, normals, camera)[texels.faces])
        for first in range(0, len(candidates), TEXELS_AT_ONCE):
            part = candidates[first : first + TEXELS_AT_ONCE]
            points, towards = _filled_up(texels.points[part]), _filled_up(normals[texels.faces[part]])
            sums[part] += np.asarray(_sightings(points, towards, camera, layers))[: len(part)]
    weights = sums[:, 3:]
    is_seen = weights[:, 0] > 0
    colors = sums[:, :3] / np.where(is_seen[:, None], weights, 1)
    return to_bytes(colors), is_seen


def filled_in(
    picture: Picture, camera: Camera, covered: np.ndarray, background: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Colours times coverage, and coverage: whole where the mesh fills a pixel with all those around it.

    What shines through there is the surface's; at the mesh's rim it is what is beyond.
    """
    if background is None:
        return picture.colors, picture.alphas
    inner: np.ndarray = ndimage.binary_erosion(covered, np.ones((3, 3), bool))  # pyright: ignore[reportAssignmentType]
    under = np.asarray(color_behind(jnp.asarray(background, jnp.float32), camera))
    through = np.where(inner & (picture.alphas > MIN_COVERAGE), 1 - picture.alphas, 0)
    return picture.colors + through[..., None] * under, picture.alphas + through


def may_be_seen(mesh: Mesh, normals: np.ndarray, camera: Camera) -> np.ndarray:
    """`[F]` bool: triangles that face the camera and are not outside its image as a whole, or behind it."""
    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
    center = viewmat_center(viewmat)
    is_facing = np.sum(normals * (center - mesh.vertices[mesh.faces[:, 0]]), axis=1) > 0
    in_camera = mesh.vertices @ viewmat[:3, :3].T + viewmat[:3, 3]
    # A corner is within a border of the image where its weighted pixel is: that holds on either side of z = 0.
    (x, y), z = (in_camera @ K.T).T[:2], in_camera[:, 2]
    within = np.stack([z > 0, x > 0, y > 0, x < camera.width * z, y < camera.height * z])
    return is_facing & within[:, mesh.faces].any(axis=2).all(axis=0)


def _sighting(point: Array, normal: Array, camera: Camera, layers: Array) -> Array:
    """`[4]` weighted colour and weight of one point of the surface in one view; zeros where it is not seen.

    The four pixels around it are mixed bilinearly, those left out that show something else: where the mesh is
    before or behind the point, where Gaussians float before it, or where nothing much is. The layers `[H, W, 6]` are
    colours times coverage, coverage, depth of the mesh, and depth of the Gaussians.
    """
    in_camera = pinhole.world_to_camera(point, camera)
    depth = jnp.maximum(in_camera[2], 1e-6)
    x, y = pinhole.project(in_camera, camera)
    is_inside = (in_camera[2] > 0) & (x >= 0.5) & (x <= camera.width - 0.5) & (y >= 0.5) & (y <= camera.height - 0.5)

    to_camera = pinhole.center(camera) - point
    cosine = jnp.sum(normal * to_camera) / jnp.maximum(jnp.sqrt(jnp.sum(to_camera * to_camera)), 1e-12)
    is_facing = cosine > MIN_COSINE
    cosine = jnp.where(is_facing, cosine, 1)
    focal = jnp.sqrt(camera.K[0, 0] * camera.K[1, 1])
    slope = jnp.sqrt(jnp.maximum(1 - cosine * cosine, 0)) / cosine
    slack = depth * (DEPTH_SLACK + PIXEL_SLACK * slope / focal)

    def pixel(right: int, down: int) -> Array:
        """`[4]` what one of the four pixels adds."""
        column, row = jnp.floor(left).astype(jnp.int32) + right, jnp.floor(top).astype(jnp.int32) + down
        here = layers[jnp.minimum(row, camera.height - 1), jnp.minimum(column, camera.width - 1)]
        share = jnp.abs(1 - right - (left - jnp.floor(left))) * jnp.abs(1 - down - (top - jnp.floor(top)))
        is_own = (jnp.abs(here[4] - depth) <= slack) & (here[5] * (1 + RENDERED_SLACK) >= depth)
        return jnp.where(is_own & (here[3] > MIN_COVERAGE), share, 0) * here[:4]

    left, top = (jnp.where(is_inside, at, 0.5) - 0.5 for at in (x, y))
    mixed = pixel(0, 0) + pixel(1, 0) + pixel(0, 1) + pixel(1, 1)
    return jnp.where(is_inside & is_facing, cosine * (focal / depth) ** 2, 0) * mixed


_sightings = jax.jit(jax.vmap(_sighting, in_axes=(0, 0, None, None)))


def _filled_up(rows: np.ndarray) -> np.ndarray:
    """`rows` with zeros up to `TEXELS_AT_ONCE`: one compiled size for all."""
    return np.pad(rows, ((0, TEXELS_AT_ONCE - len(rows)), (0, 0)))


TEXELS_PER_PIXEL = 4.0  # Two along either side: with fewer, what is between pixels is lost (docs/meshes.md#texture).
TEXELS_PER_TRIANGLE = 16.0  # Room for charts and the gaps between them, where triangles are smaller than pixels.
FILLED = 0.5  # Of the square, by charts (measured: 0.49 to 0.53).
STEP = 256  # Sides are multiples of this.


def texture_side(mesh: Mesh, cameras: Sequence[Camera], *, least: int, most: int) -> int:
    """Side, `least` to `most` texels, of the smallest texture that holds what the cameras resolve on the surface."""
    finest = np.zeros(mesh.num_faces)
    for camera in cameras:
        finest = np.maximum(finest, pixels_of_faces(mesh, camera))
    texels = max(TEXELS_PER_PIXEL * finest.sum(), TEXELS_PER_TRIANGLE * mesh.num_faces) / FILLED
    return min(max(STEP * math.ceil(math.sqrt(texels) / STEP), least), most)


def pixels_of_faces(mesh: Mesh, camera: Camera) -> np.ndarray:
    """`[F]` pixels that a triangle covers in a view, at its centre's distance and slant; what hides it is ignored.

    0 of those that face away, are outside the image or have their centre behind the camera; an image's at most.
    """
    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
    corners = (mesh.vertices @ viewmat[:3, :3].T + viewmat[:3, 3])[mesh.faces]
    center = corners.mean(axis=1)
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_shown = may_be_seen(mesh, face_normals(mesh), camera) & (center[:, 2] > 0)
    depth = np.where(is_shown, center[:, 2], 1.0)
    # The derivative of the projection: an area A with normal n at p covers fx fy A |n . p| / z^3.
    covered = K[0, 0] * K[1, 1] * np.abs(np.sum(doubled * center, axis=1)) / 2 / depth**3
    return np.where(is_shown, np.minimum(covered, camera.width * camera.height), 0.0)
