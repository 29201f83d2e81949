"""Photos as the compiled step reads them: one compact record a view, on the device when its turn comes."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.errors import InputError
from gsjax.scene import Frame, Keep, Pixels, in_memory
from gsjax.scene.cameras import Camera

NORMAL_UNIT = 127  # What a component of 1 is stored as: 3 bytes a normal, off by 0.2 degrees on average.


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Target:
    """What the render of one view is compared with: a photo, padded at the right and the bottom. numpy, or on a device.

    What is None is not stored and not in the compiled program.
    """

    viewmat: Array  # [4, 4]
    K: Array  # [3, 3]
    size: Array  # [2] int32 width and height of the photo itself
    image: Array  # [H, W, 3] uint8, straight
    valid: Array | None  # [H, W] bool; None: all of the photo
    matte: Array | None  # [H, W] uint8
    normals: Array | None = None  # [H, W, 3] int8, camera frame, times `NORMAL_UNIT` and confidence; zero: none
    depth: Array | None = None  # [H, W] float32 camera z that was measured, scene units; zero where nothing was
    trust: Array | None = None  # [H, W] uint8, how far that is trusted, of 255
    photo: Array | None = None  # [] int32, which of the run's photos it is, where an effect has numbers for each
    sky: Array | None = None  # [H, W] bool, where the photo shows open sky
    beside: "Target | None" = None  # another view of the same step, where a term compares two
    turn: Array | None = None  # [] int32, the steps before it: a state of another step is left as it is. None: of any

    @property
    def camera(self) -> Camera:
        """The view of the padded photo."""
        height, width = self.image.shape[:2]
        return Camera(self.viewmat, self.K, width, height)


@dataclass(frozen=True)
class Targets:
    """V photos in host memory or mapped from the disk, alike in size and content: one compiled step serves them."""

    targets: tuple[Target, ...]
    neighbors: np.ndarray | None = None  # [V, M] which views may stand beside each, where a term compares two
    names: tuple[str, ...] = ()  # of the photos, where they are known

    @property
    def num_views(self) -> int:
        """Number of photos."""
        return len(self.targets)

    @property
    def size(self) -> tuple[int, int]:
        """Padded width and height."""
        height, width = self.targets[0].image.shape[:2]
        return width, height

    @property
    def has_mattes(self) -> bool:
        """Whether the photos tell an object from its background."""
        return self.targets[0].matte is not None

    @property
    def num_bytes(self) -> int:
        """What all of them take on a device."""
        return sum(leaf.nbytes for leaf in jax.tree.leaves(self.targets))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Batch:
    """One view as the loss terms read it."""

    camera: Camera
    image: Array  # [H, W, 3] 0..1, already over the background
    valid: Array  # [H, W] bool
    matte: Array | None  # [H, W] 0..1
    normals: Array | None  # [H, W, 3] camera frame, as long as they are trusted; zero where there is none
    photo: Array | None = None  # [] int32, see `Target`
    depth: Array | None = None  # [H, W] camera z that was measured, scene units; zero where nothing was
    trust: Array | None = None  # [H, W] 0..1, how far that is trusted
    sky: Array | None = None  # [H, W] bool, where the photo shows open sky


def read_targets(frames: Sequence[Frame], *, scale: int = 1, keep: Keep = in_memory) -> Targets:
    """Read the pixels of frames.

    Args:
        frames: Photos of any sizes.
        scale: Reduce each by this factor (mean over blocks; a rest at the right and the bottom is dropped). Colours
            are weighted by matte and validity, so what an unused pixel happens to hold never bleeds in.
        keep: Where they are to lie.

    Returns:
        `Targets` of the largest (reduced) width and height. A photo of that size that is not reduced is not copied.

    Raises:
        InputError: The reduced photos have no pixels, or a photo cannot be read.
    """
    width, height = (max(getattr(frame, side) for frame in frames) // scale for side in ("width", "height"))
    if width < 1 or height < 1:
        raise InputError(
            f"a phase looks at photos {scale} times smaller: nothing is left of one of"
            f" {frames[0].width}x{frames[0].height} pixels"
        )
    targets = [_target(frame, scale, width, height, keep) for frame in frames]
    return Targets(tuple(_alike(_alike(targets, "matte"), "valid")), names=tuple(frame.name for frame in frames))


def with_normals(views: Targets, maps: Iterable[np.ndarray], scale: int = 1, keep: Keep = in_memory) -> Targets:
    """The same views with int8 normal maps `[H, W, 3]` (see `Target`) of the full photos; `scale` as in `read_targets`.

    A smaller pixel has the mean of its normals: the less they agree, the shorter it is and the less it counts.
    """
    reduced = (keep(_padded(normals if scale == 1 else _block_mean(normals, scale), *views.size)) for normals in maps)
    pairs = zip(views.targets, reduced, strict=True)
    return replace(views, targets=tuple(replace(target, normals=normals) for target, normals in pairs))


def with_depths(views: Targets, depths: Iterable[tuple[np.ndarray, np.ndarray]], keep: Keep = in_memory) -> Targets:
    """The same views with measured depth and its confidence (see `Target`), each pair of its photo's size."""
    padded = ([keep(_padded(array, *views.size)) for array in pair] for pair in depths)
    pairs = zip(views.targets, padded, strict=True)
    return replace(views, targets=tuple(replace(target, depth=depth, trust=trust) for target, (depth, trust) in pairs))


def with_skies(views: Targets, skies: Sequence[np.ndarray | None], scale: int = 1, keep: Keep = in_memory) -> Targets:
    """The same views told where they show sky: `[H, W]` bool of each full photo, or None; `scale` as in `read_targets`.

    A smaller pixel is sky where all that it is the mean of are.
    """
    width, height = views.size
    nothing = np.zeros((height, width), bool)
    reduced = (nothing if sky is None else keep(_padded(~_any_of_blocks(~sky, scale), width, height)) for sky in skies)
    pairs = zip(views.targets, reduced, strict=True)
    return replace(views, targets=tuple(replace(target, sky=sky) for target, sky in pairs))


def with_photo_numbers(views: Targets) -> Targets:
    """The same views, each told which of them it is."""
    targets = (replace(target, photo=np.int32(index)) for index, target in enumerate(views.targets))
    return replace(views, targets=tuple(targets))


def feed(views: Targets, *, room: int) -> Callable[[Sequence[int], Sequence[int]], list[Target]]:
    """How targets reach the device: all at once where they fit, else each in its turn, the next ones meanwhile.

    Args:
        views: The photos.
        room: Bytes of the device's memory that photos may take, see `device_room`.

    Returns:
        (indices, those that will be asked for next) -> the targets on the device; the same bits either way.
    """
    if views.num_bytes <= room:
        resident = jax.device_put(views.targets)
        return lambda wanted, following: [resident[index] for index in wanted]
    there: dict[int, Target] = {}

    def streamed(wanted: Sequence[int], following: Sequence[int]) -> list[Target]:
        for index in (*wanted, *following):
            if index not in there:
                there[index] = jax.device_put(views.targets[index])
        here = [there[index] for index in wanted]
        for index in set(there) - set(following):
            del there[index]
        return here

    return streamed


def device_room(share: float) -> int:
    """A share of the device's memory, bytes; none on a CPU, where a second copy of what the host holds helps nobody."""
    memory = jax.devices()[0].memory_stats()
    return int(share * memory["bytes_limit"]) if memory else 0


def batch(target: Target, background: Array) -> Batch:
    """A target as the loss terms read it, its photo laid over `background` `[3]` by its matte."""
    height, width = target.image.shape[:2]
    image = target.image.astype(jnp.float32) / 255
    matte = None
    if target.matte is not None:
        matte = target.matte.astype(jnp.float32) / 255
        image = image * matte[..., None] + (1 - matte)[..., None] * background[None, None]
    in_columns = jnp.arange(width, dtype=jnp.int32) < target.size[0]
    in_rows = jnp.arange(height, dtype=jnp.int32) < target.size[1]
    valid = in_rows[:, None] & in_columns[None, :]
    if target.valid is not None:
        valid &= target.valid
    normals = None if target.normals is None else target.normals.astype(jnp.float32) / NORMAL_UNIT
    trust = None if target.trust is None else target.trust.astype(jnp.float32) / 255
    return Batch(target.camera, image, valid, matte, normals, target.photo, target.depth, trust, target.sky)


def _target(frame: Frame, scale: int, width: int, height: int, keep: Keep) -> Target:
    image, matte, valid = _reduced(frame.pixels(), scale)
    to_small = np.diag(np.array([1 / scale, 1 / scale, 1], np.float32))
    return Target(
        viewmat=frame.viewmat,
        K=to_small @ frame.K,
        size=np.array(image.shape[1::-1], np.int32),
        image=keep(_padded(image, width, height)),
        valid=None if valid is None else keep(_padded(valid > 127, width, height)),
        matte=None if matte is None else keep(_padded(matte, width, height)),
    )


def _alike(targets: list[Target], name: str) -> list[Target]:
    """All with this field or none: where one has it, the others' is full."""
    found = next((array for target in targets if (array := getattr(target, name)) is not None), None)
    if found is None:
        return targets
    full = np.full(found.shape, True if found.dtype == bool else 255, found.dtype)
    return [replace(target, **{name: full}) if getattr(target, name) is None else target for target in targets]


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


def _any_of_blocks(mask: np.ndarray, scale: int) -> np.ndarray:
    height, width = mask.shape[0] // scale, mask.shape[1] // scale
    blocks = mask[: height * scale, : width * scale].reshape(height, scale, width, scale)
    return np.logical_or.reduce(blocks, axis=(1, 3))


def _block_mean(array: np.ndarray, scale: int, weights: np.ndarray | None = None) -> np.ndarray:
    height, width = array.shape[0] // scale, array.shape[1] // scale

    def sums(pixels: np.ndarray, kind: type) -> np.ndarray:
        blocks = pixels[: height * scale, : width * scale].reshape(height, scale, width, scale, *pixels.shape[2:])
        return blocks.sum(axis=(1, 3), dtype=kind)

    mean = sums(array, np.int64) / scale**2
    if weights is not None:
        total = sums(weights, np.float64)
        weighted = sums(array * weights, np.float64) / np.where(total > 0, total, 1)
        mean = np.where(total > 0, weighted, mean)  # A block without weight: the plain mean.
    return np.rint(mean).astype(array.dtype)
