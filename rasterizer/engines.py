"""Which engine blends the tiles, and how many channels at a time."""

import logging
from functools import cache, partial
from threading import Thread
from types import ModuleType
from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array

from rasterizer import _mosaic, _pallas, _reference, _xla
from rasterizer.arrays import in_float32
from rasterizer.binning import TileGrid, TilePairs
from rasterizer.compositing import Engine, Front, Static, composite, composite_unlisted
from rasterizer.devices import default_device, has_triton, wants_determinism, why_no_kernels
from rasterizer.manual_axes import vary_alike, without_axes
from rasterizer.projection import Projection
from rasterizer.reverse_mode import reverse_only
from rasterizer.rules import GSPLAT, Rules

Backend = Literal["auto", "native", "xla", "pallas", "reference"]
# 8 halves the wasted pixels of small splats, measured on CPU.
TILE_SIZES = {"native": 8, "xla": 8, "pallas": 16, "reference": 8}
CHANNEL_CHUNK = 16  # Channels per pass: more would not fit a CPU's, or a GPU thread's, registers.

logger = logging.getLogger("rasterizer")


def resolve(backend: Backend) -> Backend:
    """The backend that "auto" stands for on jax's default device."""
    if backend != "auto":
        return backend
    device = default_device()
    if device.platform == "cpu":
        return "native" if _native_or_none() else "xla"
    reason = why_no_kernels(device)
    return "pallas" if reason is None else _in_jnp(reason)


@cache
def _in_jnp(reason: str) -> Backend:
    """Says why, once."""
    logger.warning("the rasterizer runs in jnp: %s", reason)
    return "xla"


def prepare() -> None:
    """Begins, beside other work, to compile what "auto" stands for on this machine; what is on disk is only loaded.

    Whoever needs it meanwhile waits for it.
    """
    Thread(target=resolve, args=("auto",), name="rasterizer", daemon=True).start()


def _native() -> ModuleType:
    """The native loops, compiled or loaded.

    Raises:
        ImportError: There is no numba here, or XLA's interface is not the one that they are written for.
    """
    from rasterizer import _native

    return _native


@cache
def _native_or_none() -> ModuleType | None:
    try:
        return _native()
    except ImportError as error:
        logger.warning("the CPU's rasterizer runs in jnp, several times slower than its native loops: %s", error)
        return None


def _engine(backend: Backend) -> Engine:
    kind = resolve(backend)
    if kind == "native":
        return _native().ENGINE
    if kind != "pallas":
        return _xla.ENGINE
    device = default_device()
    reason = why_no_kernels(device)
    if reason and device.platform == "gpu":
        raise ValueError(f"backend='pallas': {reason}")
    kernels = _pallas if reason or has_triton() else _mosaic
    how = {"sum_rows": _pallas.sorted_sums} if wants_determinism() else {}
    return kernels.engine(interpret=reason is not None, **how)


def lists_by_itself(backend: Backend = "auto") -> bool:
    """Whether `blend` of a backend needs no lists: it lists splats in memory of its own, in every pass."""
    return resolve(backend) == "reference" or _engine(backend).unlisted is not None


def default_tile_size(backend: Backend = "auto") -> int:
    """The side of a tile that suits a backend, pixels."""
    return TILE_SIZES[resolve(backend)]


def bin_splats(
    projection: Projection,
    opacities: Array,
    grid: TileGrid,
    capacity: int,
    rules: Rules,
    masks: Array | None = None,
    *,
    backend: Backend = "auto",
) -> TilePairs:
    """List, for every tile, the splats whose alpha passes the cut at one of its pixel centres, front to back.

    Args:
        projection: Splats of `grid.num_cameras` cameras.
        opacities: `[N]` or `[C, N]` opacity of each splat.
        grid: The tiles. Static.
        capacity: Length of the pair buffer. Static.
        rules: Decides the alpha cut. Static.
        masks: `[C, tiles_y, tiles_x]` bool, the tiles that are wanted; None for all. The others get empty lists.
        backend: The lists of all are the same; "reference" lists as "xla" does. Static.

    Returns:
        `TilePairs`, not differentiable. If `overflowed`, pairs are missing.
    """
    lists = _engine(backend).lists

    def listed(projection, opacities, masks):
        return lists(projection, opacities, grid, capacity, rules, masks)

    return without_axes(listed, *jax.lax.stop_gradient((projection, opacities, masks)))


def blend(
    projection: Projection,
    opacities: Array,
    features: Array,
    pairs: TilePairs | None,
    grid: TileGrid,
    rules: Rules = GSPLAT,
    *,
    backend: Backend = "auto",
    masks: Array | None = None,
    with_median: bool = False,
    front: Front | None = None,
    absgrad: Array | None = None,
) -> tuple[Array, Array, Array | None]:
    """Blend any channels over lists that are already there: one binning serves several passes.

    Args:
        projection: Splats of `grid.num_cameras` cameras.
        opacities: `[N]` or `[C, N]`.
        features: `[C, N, D]`.
        pairs: Lists of `bin_splats` for this projection and grid. None: the backend lists splats in memory of its own,
            see `lists_by_itself`.
        grid: The tiles. Static.
        rules: Thresholds. Static.
        backend: "reference" looks at no list: every splat is blended at every pixel. Static.
        masks: As in `bin_splats`, where `pairs` is None.
        with_median: Whether the median splats are wanted. Static.
        front: How many of the last channels end with the first layers, and where. Static.
        absgrad: `[C, N, 2]` zeros: nothing depends on them, and their gradient is the sum over pixels of *absolute*
            gradients to `means2d`, which AbsGS splits by. One more pass over the pairs, in jnp whatever the backend.

    Returns:
        `[C, H, W, D]` features blended on nothing, `[C, H, W, 1]` transmittance left, and `[C, H, W]` int32 the splat
        c * N + n in which each pixel's light falls to one half (the last one that shows, where it does not; -1 for
        none), or None. Differentiable to `means2d` and `conics` of the projection, opacities and features.

    Raises:
        ValueError: If the tiles do not suit the backend, there is no camera or no channel, or `absgrad` is given to
            "reference", without pairs, or for more channels than one pass has; or if there are no pairs and the
            backend does not list splats by itself.
        TypeError: In forward mode, or differentiated a second time, unless the backend is "reference".
    """
    projection, opacities, features, pairs, absgrad = vary_alike((projection, opacities, features, pairs, absgrad))
    opacities = jnp.broadcast_to(opacities, projection.depths.shape)
    channels, side = features.shape[2], grid.tile_size
    if not channels or not grid.num_cameras:
        raise ValueError(f"features.shape={features.shape} holds no {'camera' if channels else 'channel'}")
    kind = resolve(backend)
    if kind == "pallas" and side & (side - 1):
        raise ValueError(f"tile_size={side} is not a power of two, as backend='pallas' needs it")
    if kind == "native" and side > _native().MAX_SIDE:
        raise ValueError(f"tile_size={side} is over {_native().MAX_SIDE}, the most that backend='native' holds")
    if absgrad is not None and (kind == "reference" or channels > CHANNEL_CHUNK):
        raise ValueError(f"absgrad needs a tile backend and at most {CHANNEL_CHUNK} channels, not {kind}, {channels}")
    if pairs is None and not lists_by_itself(backend):
        raise ValueError(f"pairs=None: backend={kind!r} needs the lists of bin_splats")
    if absgrad is not None and pairs is None:
        raise ValueError("absgrad needs the lists of bin_splats, not pairs=None")
    if features.shape[1] == 0:
        shape = (grid.num_cameras, grid.height, grid.width)
        median = jnp.full(shape, -1, jnp.int32) if with_median else None
        return jnp.zeros((*shape, channels), features.dtype), jnp.ones((*shape, 1), features.dtype), median
    if kind == "reference":
        # Depth has channels of its own here: no feature is to be read on a splat's plane.
        dtype = projection.means2d.dtype
        flat, opacities, features = projection._replace(slopes=None), opacities.astype(dtype), features.astype(dtype)
        return _reference.composite(flat, opacities, features, grid.width, grid.height, rules, front)
    if front and channels > CHANNEL_CHUNK:
        others = features[..., : channels - front.channels], features[..., channels - front.channels :]
        part = partial(blend, projection, opacities, pairs=pairs, grid=grid, rules=rules, backend=backend, masks=masks)
        image, left, median = part(features=others[0], with_median=with_median)
        ended, *_ = part(features=others[1], front=front)
        return jnp.concatenate([image, ended], -1), left, median
    absolute = None if absgrad is None else _xla.absolute_gradients
    static = Static(grid, rules, _engine(backend), with_median, front, absolute)
    splats = (
        reverse_only(in_float32(projection.means2d).reshape(-1, 2)),
        reverse_only(in_float32(projection.conics).reshape(-1, 3)),
        reverse_only(in_float32(jnp.where(projection.visible, opacities, 0)).reshape(-1)),
    )
    flat = reverse_only(in_float32(features).reshape(-1, channels))
    probe = None if absgrad is None else reverse_only(in_float32(absgrad).reshape(-1, 2))
    listed = ()
    if pairs is None:
        assert static.engine.unlisted is not None, "checked above"
        listed = static.engine.unlisted.listed(projection, opacities, grid, rules, masks)

    def one_pass(channels: Array):
        if pairs is None:
            return composite_unlisted(static, *splats, channels, listed)
        return composite(static, *splats, channels, pairs.splats, pairs.offsets, probe)

    if channels <= CHANNEL_CHUNK:
        return one_pass(flat)
    # Equal chunks of one compiled pass; the light left and the median come from the first.
    num_chunks = -(-channels // CHANNEL_CHUNK)
    width = -(-channels // num_chunks)
    padded = jnp.pad(flat, ((0, 0), (0, num_chunks * width - channels)))
    chunks = jnp.moveaxis(padded.reshape(-1, num_chunks, width), 1, 0)
    images, left, median = jax.lax.map(one_pass, chunks)
    image = jnp.concatenate(list(images), -1)[..., :channels]
    return image, left[0], None if median is None else median[0]
