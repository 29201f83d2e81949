"""Photos as the compiled step reads them: one compact record a view, on the device when its turn comes."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float32, Int32, Num

from gsjax.errors import InputError
from gsjax.scene import Frame, Keep, Pixels, in_memory
from gsjax.scene.cameras import Camera

NORMAL_UNIT = 127  # What a component of 1 is stored as: 3 bytes a normal, off by 0.2 degrees on average.


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Batch:
    """One photo as a step reads it, padded at the right and the bottom. A field that is None is not compiled.

    `read_batches` makes it compact: bytes, in numpy or on a device. `decode` makes of it what loss terms read: floats,
    the photo over its background, and `valid` without the padding.
    """

    camera: Camera  # of the padded photo
    image: Num[Array, "H W 3"]  # uint8, straight; decoded: 0..1, over the background
    valid: Any  # [H, W] bool; None: all of the photo, until decoded
    matte: Num[Array, "H W"] | None  # uint8; decoded: 0..1
    normals: Num[Array, "H W 3"] | None = None  # camera frame, times confidence; int8 of `NORMAL_UNIT`, or 0..1
    photo: Int32[Array, ""] | None = None  # number of the photo in the run, where an effect has parameters for each
    depth: Float32[Array, "H W"] | None = None  # measured camera z, scene units; zero where nothing was measured
    trust: Num[Array, "H W"] | None = None  # uint8 confidence of the measured depth; decoded: 0..1
    sky: Bool[Array, "H W"] | None = None  # where the photo shows open sky
    size: Any = None  # [2] int32 width and height of the photo without padding; decoded: None
    neighbor: "Batch | None" = None  # another view of the same step, where a term compares two; decoded: None
    turn: Int32[Array, ""] | None = None  # number of the only step that it is for: other states stay; None: of any


@dataclass(frozen=True)
class Batches:
    """V photos in host memory or mapped from the disk, alike in size and content: one compiled step serves them."""

    views: tuple[Batch, ...]
    neighbors: np.ndarray | None = None  # [V, M] indices of the views that a term may compare each with
    names: tuple[str, ...] = ()  # of the photos, where they are known

    @property
    def num_views(self) -> int:
        """Number of photos."""
        return len(self.views)

    @property
    def size(self) -> tuple[int, int]:
        """Padded width and height."""
        return self.views[0].camera.width, self.views[0].camera.height

    @property
    def has_mattes(self) -> bool:
        """Whether the photos separate an object from its background."""
        return self.views[0].matte is not None

    @property
    def num_bytes(self) -> int:
        """Bytes of all photos on a device."""
        return sum(leaf.nbytes for leaf in jax.tree.leaves(self.views))


def read_batches(frames: Sequence[Frame], *, scale: int = 1, keep: Keep = in_memory) -> Batches:
    """Read the pixels of frames.

    Args:
        frames: Photos of any sizes.
        scale: Reduce each by this factor (mean over blocks; a rest at the right and the bottom is dropped). Colours
            are weighted by matte and validity, so what an unused pixel happens to hold never bleeds in.
        keep: Where they are to be.

    Returns:
        `Batches` of the largest (reduced) width and height. A photo of that size that is not reduced is not copied.

    Raises:
        InputError: The reduced photos have no pixels, or a photo cannot be read.
    """
    width, height = (max(getattr(frame, side) for frame in frames) // scale for side in ("width", "height"))
    if width < 1 or height < 1:
        raise InputError(
            f"a phase trains on photos {scale} times smaller: nothing is left of one of"
            f" {frames[0].width}x{frames[0].height} pixels"
        )
    views = [_read_batch(frame, scale, width, height, keep) for frame in frames]
    return Batches(tuple(_alike(_alike(views, "matte"), "valid")), names=tuple(frame.name for frame in frames))


def with_normals(data: Batches, maps: Iterable[np.ndarray], scale: int = 1, keep: Keep = in_memory) -> Batches:
    """The same photos with int8 normal maps `[H, W, 3]` (see `Batch`) of full size; `scale` as in `read_batches`.

    A reduced pixel has the mean of its normals: the more they differ, the shorter the mean is, and the less it counts.
    """
    reduced = (keep(_padded(normals if scale == 1 else _block_mean(normals, scale), *data.size)) for normals in maps)
    return _with_fields(data, ({"normals": normals} for normals in reduced))


def with_depths(data: Batches, depths: Iterable[tuple[np.ndarray, np.ndarray]], keep: Keep = in_memory) -> Batches:
    """The same photos with measured depth and its confidence (see `Batch`), each pair of its photo's size."""
    padded = ([keep(_padded(array, *data.size)) for array in pair] for pair in depths)
    return _with_fields(data, ({"depth": depth, "trust": trust} for depth, trust in padded))


def with_skies(data: Batches, skies: Sequence[np.ndarray | None], scale: int = 1, keep: Keep = in_memory) -> Batches:
    """The same photos with masks of the sky, `[H, W]` bool of full size, or None; `scale` as in `read_batches`.

    A reduced pixel is sky where all pixels of its block are.
    """
    width, height = data.size
    no_sky = np.zeros((height, width), bool)
    reduced = (
        no_sky if sky is None else keep(_padded(_blocks(sky, scale).all((1, 3)), width, height)) for sky in skies
    )
    return _with_fields(data, ({"sky": sky} for sky in reduced))


def with_photo_numbers(data: Batches) -> Batches:
    """The same photos, each with its number."""
    return _with_fields(data, ({"photo": np.int32(index)} for index in range(data.num_views)))


def feed(data: Batches, *, room: int) -> Callable[[Sequence[int], Sequence[int]], list[Batch]]:
    """A function that moves photos to the device: all at once where they fit in `device_room`, else before their step.

    It is (indices, indices of the next step) -> the photos on the device; the same bits either way.
    """
    if data.num_bytes <= room:
        resident = jax.device_put(data.views)
        return lambda indices, following: [resident[index] for index in indices]
    on_device: dict[int, Batch] = {}

    def streamed(indices: Sequence[int], following: Sequence[int]) -> list[Batch]:
        for index in (*indices, *following):
            if index not in on_device:
                on_device[index] = jax.device_put(data.views[index])
        now = [on_device[index] for index in indices]
        for index in set(on_device) - set(following):
            del on_device[index]
        return now

    return streamed


def device_room(share: float) -> int:
    """Bytes in a share of the device's memory; 0 on a CPU, where photos are in the host's memory already."""
    memory = jax.local_devices()[0].memory_stats()
    return int(share * memory["bytes_limit"]) if memory else 0


def decode(batch: Batch, background: Array) -> Batch:
    """A compact photo as loss terms read it, laid over `background` `[3]` by its matte."""
    camera, image, matte = batch.camera, batch.image.astype(jnp.float32) / 255, None
    if batch.matte is not None:
        matte = batch.matte.astype(jnp.float32) / 255
        image = image * matte[..., None] + (1 - matte)[..., None] * background[None, None]
    in_columns = jnp.arange(camera.width, dtype=jnp.int32) < batch.size[0]
    in_rows = jnp.arange(camera.height, dtype=jnp.int32) < batch.size[1]
    valid = in_rows[:, None] & in_columns[None, :]
    if batch.valid is not None:
        valid &= batch.valid
    normals = None if batch.normals is None else batch.normals.astype(jnp.float32) / NORMAL_UNIT
    trust = None if batch.trust is None else batch.trust.astype(jnp.float32) / 255
    return Batch(camera, image, valid, matte, normals, batch.photo, batch.depth, trust, batch.sky)


def _read_batch(frame: Frame, scale: int, width: int, height: int, keep: Keep) -> Batch:
    image, matte, valid = _reduced(frame.pixels(), scale)
    to_small = np.diag(np.array([1 / scale, 1 / scale, 1], np.float32))
    return Batch(
        Camera(frame.viewmat, to_small @ frame.K, width, height),
        keep(_padded(image, width, height)),
        valid=None if valid is None else keep(_padded(valid > 127, width, height)),
        matte=None if matte is None else keep(_padded(matte, width, height)),
        size=np.array(image.shape[1::-1], np.int32),
    )


def _with_fields(data: Batches, fields: Iterable[dict[str, np.ndarray]]) -> Batches:
    """The same photos with other values of some fields, a dictionary each."""
    return replace(data, views=tuple(replace(view, **new) for view, new in zip(data.views, fields, strict=True)))


def _alike(views: list[Batch], name: str) -> list[Batch]:
    """All with this field or none: where one has it, the others' is full."""
    first = next((array for view in views if (array := getattr(view, name)) is not None), None)
    if first is None:
        return views
    full = np.full(first.shape, True if first.dtype == bool else 255, first.dtype)
    return [replace(view, **{name: full}) if getattr(view, name) is None else view for view in views]


def _padded(array: np.ndarray, width: int, height: int) -> np.ndarray:
    missing = [(0, height - array.shape[0]), (0, width - array.shape[1])] + [(0, 0)] * (array.ndim - 2)
    return np.pad(array, missing) if np.any(missing) else array


def _reduced(pixels: Pixels, scale: int) -> Pixels:
    if scale == 1:
        return pixels
    image, matte, valid = pixels
    weights = [mask / 255.0 for mask in (matte, valid) if mask is not None]
    return Pixels(
        _block_mean(image, scale, np.prod(weights, axis=0)[..., None] if weights else None),
        None if matte is None else _block_mean(matte, scale),
        None if valid is None else _block_mean(valid, scale),
    )


def _blocks(array: np.ndarray, scale: int) -> np.ndarray:
    """`[h, scale, w, scale, ...]` the blocks of an array `[H, W, ...]`, without a rest at the right and the bottom."""
    height, width = array.shape[0] // scale, array.shape[1] // scale
    return array[: height * scale, : width * scale].reshape(height, scale, width, scale, *array.shape[2:])


def _block_mean(array: np.ndarray, scale: int, weights: np.ndarray | None = None) -> np.ndarray:
    mean = _blocks(array, scale).sum(axis=(1, 3), dtype=np.int64) / scale**2
    if weights is not None:
        total = _blocks(weights, scale).sum(axis=(1, 3), dtype=np.float64)
        weighted = _blocks(array * weights, scale).sum(axis=(1, 3), dtype=np.float64) / np.where(total > 0, total, 1)
        mean = np.where(total > 0, weighted, mean)  # A block without weight: the plain mean.
    return np.rint(mean).astype(array.dtype)
