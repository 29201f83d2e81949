"""How a mesh looks in held-out photos, compared with its Gaussians at the same pixels."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from gsjax.gaussians import Gaussians
from gsjax.meshing.pictures import Shading, smooth_pictures
from gsjax.metrics.photos import color_behind_all, score_images, score_pictures
from gsjax.rendering.gallery import Picture
from gsjax.runs.photo_effects import PhotoEffects
from gsjax.runs.result import frame_camera
from gsjax.scene import Frame, Pixels
from gsjax.scene.meshes import Mesh

COVERED = 1 - 1e-6  # Of a pixel's rays, that must hit the mesh where it is compared.


def score_appearance(
    mesh: Mesh,
    shading: Shading,
    gaussians: Gaussians,
    frames: tuple[Frame, ...],
    background: str,
    effects: PhotoEffects,
) -> dict[str, Any]:
    """Scores over the pixels that the mesh covers as a whole: what it leaves open is reported, not scored.

    Args:
        mesh: The surface, in the frames' coordinates.
        shading: Its colours: `gsjax.meshing.pictures.texture_colors` of its texture, or `vertex_colors`.
        gaussians: What it is compared with.
        frames: Photos that neither was made from.
        background: Of the Gaussians, as of `gsjax.metrics.photos.score_images`.
        effects: As of `score_images`; its `appearances`, which see the answer or a photo's own tracks, are left out.

    Returns:
        `mesh_psnr` and `mesh_ssim`; `covered_psnr` and `covered_ssim`, of the Gaussians at the same pixels; with
        `effects.near_appearances` the same with `_near_gains`. `mesh_covers`, the share of the valid pixels, None where
        there are none. Scores are None where no frame shows the mesh; all is empty without frames.
    """
    if not frames:
        return {}
    draw = partial(smooth_pictures, mesh, shading=shading)
    pairs = zip(frames, draw([frame_camera(frame) for frame in frames]), strict=True)
    covered = [_covered(frame, picture) for frame, picture in pairs]
    scored_frames = tuple(frame for frame, share in covered if share)
    shares = [share for _, share in covered if share is not None]
    effects = effects._replace(appearances={})
    scores = {
        "mesh": score_pictures(draw, scored_frames, color_behind_all(background, effects), photo_effects=effects),
        "covered": score_images(gaussians, scored_frames, background, photo_effects=effects),
    }
    named = {f"{of}_{name}": value for of, each in scores.items() for name, value in each.items() if name != "views"}
    return named | {"mesh_covers": float(np.mean(shares)) if shares else None}


def _covered(frame: Frame, picture: Picture) -> tuple[Frame, float | None]:
    """The frame with the pixels alone that the mesh covers, and their share of those that were valid, if any were."""
    is_whole = picture.alphas > COVERED

    def pixels() -> Pixels:
        original = frame.pixels()
        return original._replace(valid=255 * (is_whole & _valid(original)).astype(np.uint8))

    valid = _valid(frame.pixels())
    return replace(frame, pixels=pixels, masked=True), float(is_whole[valid].mean()) if valid.any() else None


def _valid(pixels: Pixels) -> np.ndarray:
    return np.ones(pixels.image.shape[:2], bool) if pixels.valid is None else pixels.valid > 127
