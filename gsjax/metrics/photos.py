"""Renders of photographed views against the photos: PSNR, SSIM and further measures."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gsjax.effects.alignment import Draw
from gsjax.effects.appearance import Appearance, fit_colors
from gsjax.gaussians import Gaussians
from gsjax.io.messages import print_once
from gsjax.metrics.images import psnr, ssim
from gsjax.metrics.lpips import Measure
from gsjax.rendering import DepthReading, gallery
from gsjax.rendering.gallery import Picture
from gsjax.runs.photo_effects import PhotoEffects
from gsjax.runs.result import BACKGROUND_COLORS, frame_camera
from gsjax.scene import Frame
from gsjax.scene.cameras import Camera

NOTHING = PhotoEffects()
Aligner = Callable[[Camera, np.ndarray, np.ndarray, Draw], Camera]
"""(camera as given, photo `[H, W, 3]` 0..1, `[H, W]` bool pixels that count, what draws) -> where it was."""


def score_images(
    gaussians: Gaussians,
    frames: tuple[Frame, ...],
    background: str,
    *,
    measures: Mapping[str, Measure] = MappingProxyType({}),
    photo_effects: PhotoEffects = NOTHING,
    align: Aligner | None = None,
    depth_mode: DepthReading = "plane",
    observe: Callable[[Frame, np.ndarray, Picture], None] = lambda *_: None,
) -> dict[str, Any]:
    """Mean PSNR and SSIM over frames, as 3DGS defines them (float renders, every pixel that is valid); None of none.

    A frame without a valid pixel has no score: it is named on stderr, and is not among `views`.

    Args:
        gaussians: The scene.
        frames: Photos that it was not trained on.
        background: Colour behind it, where `photo_effects` has none that was learned.
        measures: Further ones by name. They see pictures in 0..1, both black where a pixel is not valid.
        photo_effects: What the photos' cameras did to the light, and what is behind all, where training took that in.
        align: Finds the pose that a photo was taken from; None: given poses are all that is scored.
        depth_mode: Of the pictures' depth, which no score reads.
        observe: Called with every frame, the photo `[H, W, 3]` that it is compared with, and its picture.

    Returns:
        `views`, and `psnr`, `ssim` and `measures` of the render as it is, with the exposure of the mean photo. With
        `photo_effects.near_appearances` also `psnr_near_gains`, `ssim_near_gains`: with the learned fall-off and the
        gains of the photos taken near this one; they use nothing of the photo itself. With `photo_effects.appearances`
        also `psnr_track_gains`, `ssim_track_gains`: with the gains of the photo's own tracks; and `psnr_fitted`,
        `ssim_fitted`: after the affine colour map that fits the photo best, which uses the photo. With `align` each of
        them also with `_aligned`: from the pose that fits the photo best, which uses the photo too.
    """
    color = color_behind_all(background, photo_effects)
    draw = partial(gallery.pictures, jax.tree.map(jnp.asarray, gaussians), background=color, depth_mode=depth_mode)
    return score_pictures(
        draw, frames, color, measures=measures, photo_effects=photo_effects, align=align, observe=observe
    )


def color_behind_all(background: str, effects: PhotoEffects) -> np.ndarray:
    """What is behind the Gaussians, and behind the mattes of photos that are compared with them."""
    return BACKGROUND_COLORS[background] if effects.background is None else effects.background


def score_pictures(
    draw: Callable[[Sequence[Camera]], Iterable[Picture]],
    frames: tuple[Frame, ...],
    color: np.ndarray,
    *,
    measures: Mapping[str, Measure] = MappingProxyType({}),
    photo_effects: PhotoEffects = NOTHING,
    align: Aligner | None = None,
    observe: Callable[[Frame, np.ndarray, Picture], None] = lambda *_: None,
) -> dict[str, Any]:
    """`score_images` of whatever draws the pictures of cameras, one by one: Gaussians or a mesh.

    `color` is `[3]`, or as `gsjax.rendering.backdrop` has it: what `draw` has behind all.
    """
    lights = {"_near_gains": photo_effects.near_appearances, "_track_gains": photo_effects.appearances}
    ways = ("", *(way for way, looks in lights.items() if looks), *(("_fitted",) if photo_effects.appearances else ()))
    poses = ("", "_aligned") if align else ("",)
    names = [f"{score}{way}{pose}" for pose in poses for way in ways for score in ("psnr", "ssim")]
    scores, masked = [], []
    every = draw([frame_camera(frame) for frame in frames]) if frames else ()
    for frame, picture in zip(frames, every, strict=True):
        photo = _photo(frame, color)
        observe(frame, photo.target, picture)
        if not photo.valid.any():
            masked.append(frame.name)
            continue
        lit = {way: _as_taken(looks, frame, photo.under) for way, looks in lights.items()}
        pictures = [picture]
        if align:
            taken_pictures = partial(_photographs, draw, lit["_track_gains"])
            pictures += draw([align(frame_camera(frame), photo.target, photo.valid, taken_pictures)])
        renders = [render for each in pictures for render in _renders(each, photo, lit, ways)]
        pair = [np.clip(colors, 0, 1) * photo.valid[..., None] for colors in (picture.colors, photo.target)]
        scores.append(
            [each for render in renders for each in _scores(*map(jnp.asarray, (render, photo.target, photo.valid)))]
            + [measure(*pair) for measure in measures.values()]
        )
    if masked:
        print_once(f"not scored, because a mask covers every pixel: {', '.join(masked)}")
    means = np.asarray(scores, np.float64).mean(0).tolist() if scores else [None] * len((*names, *measures))
    return {**dict(zip((*names, *measures), means, strict=True)), "views": len(scores)}


class _Photo(NamedTuple):
    target: np.ndarray  # [H, W, 3] 0..1, what a picture is compared with
    valid: np.ndarray  # [H, W] bool, where
    under: np.ndarray | None  # what is behind its matte; None: it has none


def _photo(frame: Frame, color: np.ndarray) -> _Photo:
    image, matte, valid = frame.pixels()
    target = image.astype(np.float32) / 255
    valid = np.ones(target.shape[:2], bool) if valid is None else valid > 127
    if matte is None:
        return _Photo(target, valid, None)
    coverage = matte[..., None].astype(np.float32) / 255
    return _Photo(target * coverage + (1 - coverage) * color, valid, color)


def _renders(
    picture: Picture, photo: _Photo, lit: Mapping[str, Callable[[Picture], Picture]], ways: Sequence[str]
) -> list[np.ndarray]:
    """The colours of a picture in each of the ways."""
    of_way = {"": picture.colors} | {way: photograph(picture).colors for way, photograph in lit.items() if way in ways}
    if "_fitted" in ways:
        of_way["_fitted"] = np.clip(fit_colors(picture.colors, photo.target, photo.valid), 0, 1)
    return [of_way[way] for way in ways]


def _photographs(
    draw: Callable[[Sequence[Camera]], Iterable[Picture]],
    photograph: Callable[[Picture], Picture],
    cameras: Sequence[Camera],
) -> list[Picture]:
    return [photograph(picture) for picture in draw(cameras)]


def _as_taken(looks: Mapping[str, Appearance], frame: Frame, under: np.ndarray | None) -> Callable[[Picture], Picture]:
    """What a photo's camera makes of a picture; `under`: the colour that we put behind its matte."""
    if not looks:
        return lambda picture: picture
    factor = looks[frame.name].factor(frame)

    def as_taken(picture: Picture) -> Picture:
        behind = 0 if under is None else (1 - picture.alphas)[..., None] * under
        return picture._replace(colors=np.clip((picture.colors - behind) * factor + behind, 0, 1))

    return as_taken


@jax.jit
def _scores(image: jax.Array, target: jax.Array, valid: jax.Array) -> tuple[jax.Array, jax.Array]:
    return psnr(image, target, valid), ssim(image, target, valid)
