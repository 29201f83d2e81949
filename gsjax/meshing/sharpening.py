"""A texture that shows in its views what they show: the mean of what they see, corrected by what it then lacks.

A texel that is the mean of pixels around it is blurred twice, by the pixels' size and by reading between them. Where a
mesh is exact that costs more than two decibels (docs/meshes.md#texture).
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from gsjax.meshing.atlas import TexturedMesh
from gsjax.meshing.pictures import rays_in_bands, texels_around
from gsjax.meshing.ray_queries import Cast, front_faces_only, ray_caster
from gsjax.meshing.texture import MIN_COSINE, RENDERED_SLACK, filled_in
from gsjax.rendering import MIN_COVERAGE
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera
from gsjax.scene.colors import to_bytes

SIDE, MOST_PIXELS = 2, 1 << 20  # Rays along a pixel and down it, as dense as texels are; of larger photos one, which is
# cheaper and brings two thirds.
JUMP = 0.02  # Share of its depth by which the surface of one pixel may range; beyond, it shows an edge.


def sharpened(
    textured: TexturedMesh, cameras: Sequence[Camera], pictures: Iterable[Picture], background: np.ndarray | None = None
) -> TexturedMesh:
    """One round: what every pixel lacks is spread over its texels, and each texel takes the mean (SIRT, Gilbert 1972).

    Pixels at edges, at flat angles, and where Gaussians float before the surface say nothing, as in `texture_mesh`.
    The texels' mean converges to the texture whose pictures are nearest; the first two rounds add most of what views
    nearby gain, later ones noise. Cameras, pictures and background are as of `texture_mesh`.
    """
    cast = front_faces_only(textured.mesh, ray_caster(textured.mesh))
    texture = textured.texture.reshape(-1, 3).astype(np.float32) / 255
    sums = np.zeros((len(texture), 4), np.float32)
    for camera, picture in zip(cameras, pictures, strict=True):
        side = SIDE if camera.width * camera.height <= MOST_PIXELS else 1
        texels, shares, pixels, depths, cosines = _sightings(textured, cast, camera, side)
        colors, weights = _target_colors(picture, camera, side, background, pixels, depths, cosines)
        ray_colors = np.einsum("rk,rkc->rc", shares, texture[texels]) / side**2
        lacking = colors - np.stack([np.bincount(pixels, column, len(colors)) for column in ray_colors.T], axis=1)
        spread = np.column_stack([lacking * weights[:, None], weights])[pixels]
        rows, back = np.unique(texels, return_inverse=True)
        for column in range(4):
            sums[rows, column] += np.bincount(back.ravel(), (shares * spread[:, column, None]).ravel(), len(rows))
    is_seen = sums[:, 3] > 1e-3
    change = np.where(is_seen[:, None], sums[:, :3] / np.where(is_seen, sums[:, 3], 1)[:, None], 0)
    return replace(textured, texture=to_bytes(np.clip(texture + change, 0, 1)).reshape(textured.texture.shape))


def _sightings(textured: TexturedMesh, cast: Cast, camera: Camera, side: int) -> tuple[np.ndarray, ...]:
    """Of the R rays that hit: `[R, 4]` texels and their shares, `[R]` pixel, depth, and cosine to the surface."""
    parts = []
    for hits, pixels in rays_in_bands(textured.mesh, cast, camera, side):
        cosines = -np.sum(hits.normals * hits.rays, axis=1)
        parts.append((*texels_around(textured, hits), pixels, hits.depths, cosines))
    return tuple(np.concatenate(each) for each in zip(*parts, strict=True))


def _target_colors(
    picture: Picture,
    camera: Camera,
    side: int,
    background: np.ndarray | None,
    pixels: np.ndarray,
    depths: np.ndarray,
    cosines: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """`[P, 3]` what every pixel of a view is to show, and `[P]` how much it says: its cosine, or 0."""
    count = camera.width * camera.height
    hit = np.bincount(pixels, minlength=count)
    nearest, farthest = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(nearest, pixels, depths)
    np.maximum.at(farthest, pixels, depths)
    cosine = np.bincount(pixels, cosines, count) / np.maximum(hit, 1)
    colors, alphas = filled_in(picture, camera, (hit > 0).reshape(camera.height, camera.width), background)
    alphas, rendered = alphas.ravel(), picture.depth.ravel()
    is_near = (rendered <= 0) | (rendered * (1 + RENDERED_SLACK) >= farthest)
    is_whole = (hit == side**2) & (farthest - nearest < JUMP * farthest)
    says = is_whole & is_near & (alphas > MIN_COVERAGE) & (cosine > MIN_COSINE)
    return colors.reshape(-1, 3) / np.maximum(alphas, 1e-6)[:, None], np.where(says, cosine, 0)
