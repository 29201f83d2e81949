"""Photos on the device: one array per quantity, padded to a common size: one compiled step serves every view."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.cameras import Camera
from gsjax.errors import InputError
from gsjax.scene import Frame


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Views:
    """V photos, padded at the right and the bottom; padding is not valid."""

    viewmats: Array  # [V, 4, 4]
    Ks: Array  # [V, 3, 3]
    images: Array  # [V, H, W, 3] uint8, straight
    valid: Array  # [V, H, W] bool
    mattes: Array | None  # [V, H, W] uint8
    normals: Array | None = None  # [V, H, W, 3] float16, camera frame, zero where there is none

    @property
    def num_views(self) -> int:
        """Number of photos."""
        return self.images.shape[0]

    @property
    def size(self) -> tuple[int, int]:
        """Padded width and height."""
        return self.images.shape[2], self.images.shape[1]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Batch:
    """One training view on the device."""

    camera: Camera
    image: Array  # [H, W, 3] 0..1, already over the background
    valid: Array  # [H, W] bool
    matte: Array | None  # [H, W] 0..1
    normals: Array | None  # [H, W, 3] camera frame, zero where there is none


def stack_views(frames: tuple[Frame, ...], *, scale: int = 1) -> Views:
    """Put frames on the device.

    Args:
        frames: Photos of any sizes.
        scale: Reduce each by this factor (mean over blocks; a rest at the right and the bottom is dropped). Colours
            are weighted by matte and validity, so what an unused pixel happens to hold never bleeds in.

    Returns:
        `Views` of the largest (reduced) width and height.

    Raises:
        InputError: The reduced photos have no pixels.
    """
    width = max(f.width for f in frames) // scale
    height = max(f.height for f in frames) // scale
    if width < 1 or height < 1:
        raise InputError(
            f"image_scale={scale}: nothing is left of a photo of {frames[0].width}x{frames[0].height} pixels"
        )

    def stacked(arrays: list[np.ndarray]) -> np.ndarray:
        return np.stack(
            [np.pad(a, [(0, height - a.shape[0]), (0, width - a.shape[1])] + [(0, 0)] * (a.ndim - 2)) for a in arrays]
        )

    pixels = [frame.pixels() for frame in frames]
    mattes = [_full(p.image) if p.matte is None else p.matte for p in pixels]
    valid = [_full(p.image) if p.valid is None else p.valid for p in pixels]
    images = [
        _block_mean(p.image, scale, (m[..., None] / 255.0) * (v[..., None] / 255.0))
        for p, m, v in zip(pixels, mattes, valid, strict=True)
    ]
    to_small = np.diag(np.array([1 / scale, 1 / scale, 1], np.float32))
    return Views(
        viewmats=jnp.asarray(np.stack([f.viewmat for f in frames])),
        Ks=jnp.asarray(np.stack([to_small @ f.K for f in frames])),
        images=jnp.asarray(stacked(images)),
        valid=jnp.asarray(stacked([_block_mean(v, scale) for v in valid]) > 127),
        mattes=jnp.asarray(stacked([_block_mean(m, scale) for m in mattes]))
        if any(p.matte is not None for p in pixels)
        else None,
    )


def with_normals(views: Views, maps: list[np.ndarray]) -> Views:
    """The same views with `[H, W, 3]` normal maps (not larger than the views, smaller ones are padded with zeros).

    Maps are unit vectors, or int8 and 127 times as long.
    """
    width, height = views.size
    maps = [m / np.float32(127) if m.dtype == np.int8 else m for m in maps]
    stacked = np.stack(
        [np.pad(m, ((0, height - m.shape[0]), (0, width - m.shape[1]), (0, 0))).astype(np.float16) for m in maps]
    )
    return Views(**{**views.__dict__, "normals": jnp.asarray(stacked)})


def camera(views: Views, index: Array | int) -> Camera:
    """The camera of one view; the index may be traced."""
    return Camera(views.viewmats[index], views.Ks[index], *views.size)


def batch(views: Views, index: Array | int, background: Array) -> Batch:
    """One view as the loss terms read it, its photo laid over `background` `[3]` by its matte."""
    image = views.images[index].astype(jnp.float32) / 255
    matte = None
    if views.mattes is not None:
        matte = views.mattes[index].astype(jnp.float32) / 255
        image = image * matte[..., None] + (1 - matte)[..., None] * background[None, None]
    normals = None if views.normals is None else views.normals[index].astype(jnp.float32)
    return Batch(camera(views, index), image, views.valid[index], matte, normals)


def _full(image: np.ndarray) -> np.ndarray:
    return np.full(image.shape[:2], 255, np.uint8)


def _block_mean(array: np.ndarray, scale: int, weights: np.ndarray | float = 1.0) -> np.ndarray:
    if scale == 1:
        return array
    height, width = array.shape[0] // scale, array.shape[1] // scale

    def blocks(pixels: np.ndarray) -> np.ndarray:
        return pixels[: height * scale, : width * scale].reshape(height, scale, width, scale, *array.shape[2:])

    weights = blocks(np.broadcast_to(weights, array.shape))
    weights = np.where(weights.sum((1, 3), keepdims=True) > 0, weights, 1)  # A block without weight: the plain mean.
    return np.rint(np.average(blocks(array), axis=(1, 3), weights=weights)).astype(array.dtype)
