"""The engines by name: which one "auto" means, what lists and blends by it, and how many channels at a time."""

import logging
from collections.abc import Callable
from functools import cache, partial
from threading import Thread
from types import ModuleType
from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int32

from rasterizer import _mosaic, _pallas, _reference, _xla
from rasterizer.arrays import in_float32
from rasterizer.binning import TileGrid, TilePairs
from rasterizer.compositing import Engine, Front, Static, composite
from rasterizer.devices import default_device, has_triton, wants_determinism, why_no_kernels
from rasterizer.ewa import Projection
from rasterizer.rules import GSPLAT, Rules
from rasterizer.tracing import reverse_only, vary_alike, without_axes

Backend = Literal["auto", "native", "xla", "pallas", "reference"]
CHANNEL_CHUNK = 16  # Channels per pass: more would not fit a CPU's, or a GPU thread's, registers.

logger = logging.getLogger("rasterizer")


def resolve(backend: Backend) -> Backend:
    """The backend that "auto" means on jax's default device."""
    return choose()[0] if backend == "auto" else backend


def choose() -> tuple[Backend, str | None]:
    """The backend for jax's default device; and why the device's fastest one does not run, None where it does."""
    device = default_device()
    if device.platform == "cpu":
        reason = _why_no_loops()
        return ("xla", reason) if reason else ("native", None)
    reason = why_no_kernels(device)
    return ("xla", _log_once(f"the rasterizer runs in jnp: {reason}")) if reason else ("pallas", None)


@cache
def _log_once(reason: str) -> str:
    """The reason, logged the first time."""
    logger.warning("%s", reason)
    return reason


def prepare() -> None:
    """Compile what "auto" means on this machine in a thread; what is on disk is only loaded.

    A render that needs it meanwhile waits for it.
    """
    Thread(target=resolve, args=("auto",), name="rasterizer", daemon=True).start()


def load_loops() -> ModuleType:
    """The native loops, compiled or loaded.

    Raises:
        ImportError: numba is not installed, or XLA's interface is not the one that the loops are written for.
    """
    from rasterizer._native import engine

    return engine


@cache
def _why_no_loops() -> str | None:
    try:
        load_loops()
    except ImportError as error:
        return _log_once(f"the CPU's rasterizer runs in jnp, several times slower than its native loops: {error}")
    return None


def _kernels() -> Engine:
    """The GPU kernels for the default device; interpreted where there is no GPU."""
    device = default_device()
    reason = why_no_kernels(device)
    if reason and device.platform == "gpu":
        raise ValueError(f"backend='pallas': {reason}")
    kernels = _pallas if reason or has_triton() else _mosaic
    how = {"sum_rows": _pallas.sorted_sums} if wants_determinism() else {}
    return kernels.engine(interpret=reason is not None, **how)


ENGINES: dict[str, Callable[[], Engine]] = {
    "native": lambda: load_loops().ENGINE,
    "xla": lambda: _xla.ENGINE,
    "pallas": _kernels,
    "reference": lambda: _xla.ENGINE,  # of its lists; it blends without tiles
}


def _engine(backend: Backend) -> Engine:
    return ENGINES[resolve(backend)]()


def lists_by_itself(backend: Backend = "auto") -> bool:
    """Whether `blend` of a backend needs no lists: it lists splats in memory of its own, in every pass."""
    return resolve(backend) == "reference" or _engine(backend).unlisted is not None


def native_loops(backend: Backend = "auto") -> ModuleType | None:
    """The native loops where a backend uses them, else None."""
    return load_loops() if resolve(backend) == "native" else None


def default_tile_size(backend: Backend = "auto") -> int:
    """The side of a tile that suits a backend, pixels."""
    return _engine(backend).tile_size


def bin_splats(
    projection: Projection,
    opacities: Float[Array, "N"] | Float[Array, "C N"],
    grid: TileGrid,
    capacity: int,
    rules: Rules,
    masks: Bool[Array, "C tiles_y tiles_x"] | None = None,
    *,
    backend: Backend = "auto",
) -> TilePairs:
    """List, for every tile, the splats whose alpha passes the cut at one of its pixel centres, front to back.

    Args:
        projection: Splats of `grid.num_cameras` cameras.
        opacities: Of each splat; `[N]` are the same for all cameras.
        grid: The tiles. Static.
        capacity: Length of the pair buffer. Static.
        rules: Decides the alpha cut. Static.
        masks: A tile that is False gets an empty list. None for all tiles.
        backend: The lists of all are the same; "reference" lists as "xla" does. Static.

    Returns:
        `TilePairs`, not differentiable. If `overflowed`, pairs are missing.
    """
    list_splats = _engine(backend).list_splats

    def listed(projection, opacities, masks):
        return list_splats(projection, opacities, grid, capacity, rules, masks)

    return without_axes(listed, *jax.lax.stop_gradient((projection, opacities, masks)))


def blend(
    projection: Projection,
    opacities: Float[Array, "N"] | Float[Array, "C N"],
    features: Float[Array, "C N D"],
    pairs: TilePairs | None,
    grid: TileGrid,
    rules: Rules = GSPLAT,
    *,
    backend: Backend = "auto",
    masks: Bool[Array, "C tiles_y tiles_x"] | None = None,
    with_median: bool = False,
    front: Front | None = None,
    absgrad: Float[Array, "C N 2"] | None = None,
    probes: Float[Array, "C N K"] | None = None,
) -> tuple[Float[Array, "C H W _"], Float[Array, "C H W 1"], Int32[Array, "C H W"] | None]:
    """Blend any channels over given lists: one binning serves several passes.

    Args:
        projection: Splats of `grid.num_cameras` cameras.
        opacities: As in `bin_splats`.
        features: Any channels.
        pairs: Lists of `bin_splats` for this projection and grid. None: the backend lists splats in memory of its own,
            see `lists_by_itself`.
        grid: The tiles. Static.
        rules: Thresholds. Static.
        backend: "reference" reads no list: every splat is blended at every pixel. Static.
        masks: As in `bin_splats`, where `pairs` is None.
        with_median: Whether the median splats are computed. Static.
        front: How many of the last channels end with the first layers, and where. Static.
        absgrad: Zeros: nothing depends on them, and their gradient is the sum over pixels of *absolute*
            gradients to `means2d`, which AbsGS splits by. One more pass over the pairs, in jnp whatever the backend.
        probes: Channels of zeros behind the features. Their gradient is, as that of every channel, the sum over pixels
            of blending weights times the cotangent; the native loops spend nothing on them in the image.

    Returns:
        The features blended on nothing and the probes' zeros, the transmittance left, and the splat c * N + n in which
        each pixel's light falls to one half (the last one that shows, where it does not; -1 for none), or None.
        Differentiable to `means2d` and `conics` of the projection, opacities, features and probes.

    Raises:
        ValueError: If the tiles do not suit the backend, there is no camera or no channel, or `absgrad` is given to
            "reference", without pairs, or for more channels than one pass has; or if there are no pairs and the
            backend does not list splats by itself.
        TypeError: In forward mode, or differentiated a second time, unless the backend is "reference".
    """
    arrays = projection, opacities, features, pairs, absgrad, probes
    projection, opacities, features, pairs, absgrad, probes = vary_alike(arrays)
    opacities = jnp.broadcast_to(opacities, projection.depths.shape)
    kind, engine, channels = resolve(backend), _engine(backend), features.shape[2]
    _check_blend(kind, engine, features, pairs, grid, absgrad)
    num_probes = 0 if probes is None else probes.shape[2]
    how = {"pairs": pairs, "grid": grid, "rules": rules, "backend": backend, "masks": masks}
    blend_part = partial(blend, projection, opacities, **how)
    if probes is not None and (kind == "reference" or channels + num_probes > CHANNEL_CHUNK):
        image, left, median = blend_part(features, with_median=with_median, front=front, absgrad=absgrad)
        zeros, *_ = blend_part(probes)
        return jnp.concatenate([image, zeros.astype(image.dtype)], -1), left, median
    if features.shape[1] == 0:
        shape = (grid.num_cameras, grid.height, grid.width)
        median = jnp.full(shape, -1, jnp.int32) if with_median else None
        return jnp.zeros((*shape, channels + num_probes), features.dtype), jnp.ones((*shape, 1), features.dtype), median
    if kind == "reference":
        # Depth has channels of its own: no feature is read on a splat's plane.
        dtype = projection.means2d.dtype
        flat, opacities, features = projection._replace(slopes=None), opacities.astype(dtype), features.astype(dtype)
        return _reference.composite(flat, opacities, features, grid.width, grid.height, rules, front)
    if front and channels > CHANNEL_CHUNK:
        image, left, median = blend_part(features[..., : -front.channels], with_median=with_median)
        ended, *_ = blend_part(features[..., -front.channels :], front=front)
        return jnp.concatenate([image, ended], -1), left, median
    if pairs is not None:
        lists = pairs.splats, pairs.offsets
    else:
        assert engine.unlisted  # `_check_blend`
        lists = engine.unlisted(projection, opacities, grid, rules, masks)
    splats = projection.means2d, projection.conics, jnp.where(projection.visible, opacities, 0)
    splats = (reverse_only(in_float32(x).reshape(-1, *x.shape[2:])) for x in splats)
    flat = reverse_only(in_float32(features).reshape(-1, channels))
    beside = (None if x is None else reverse_only(in_float32(x).reshape(-1, x.shape[2])) for x in (absgrad, probes))
    absolute = None if absgrad is None else _xla.absolute_gradients
    static = Static(grid, rules, engine, with_median, front, num_probes, absolute)
    return _in_passes(partial(composite, static, *splats), flat, lists, *beside)


def _in_passes(blend_channels: Callable, features: Array, *others) -> tuple[Array, Array, Array | None]:
    """Blend `[M, D]` features in equal chunks of one compiled pass; the light left and the median are the first's."""
    channels = features.shape[1]
    if channels <= CHANNEL_CHUNK:
        return blend_channels(features, *others)
    num_chunks = -(-channels // CHANNEL_CHUNK)
    width = -(-channels // num_chunks)
    padded = jnp.pad(features, ((0, 0), (0, num_chunks * width - channels)))
    chunks = jnp.moveaxis(padded.reshape(-1, num_chunks, width), 1, 0)
    images, left, median = jax.lax.map(lambda chunk: blend_channels(chunk, *others), chunks)
    image = jnp.concatenate(list(images), -1)[..., :channels]
    return image, left[0], None if median is None else median[0]


def _check_blend(kind: Backend, engine: Engine, features: Array, pairs, grid: TileGrid, absgrad) -> None:
    channels = features.shape[2]
    if not channels or not grid.num_cameras:
        raise ValueError(f"features.shape={features.shape} holds no {'camera' if channels else 'channel'}")
    if kind != "reference":
        engine.check_side(grid.tile_size)
    if absgrad is not None and (kind == "reference" or channels > CHANNEL_CHUNK):
        raise ValueError(f"absgrad needs a tile backend and at most {CHANNEL_CHUNK} channels, not {kind}, {channels}")
    if pairs is None and not lists_by_itself(kind):
        raise ValueError(f"pairs=None: backend={kind!r} needs the lists of bin_splats")
    if absgrad is not None and pairs is None:
        raise ValueError("absgrad needs the lists of bin_splats, not pairs=None")
