"""gsplat's names (1.5.3, 1.6): the stages under the front door, and what `rasterization` returns besides images.

`rasterization` does not go through these stages: its lists are per-tile exact and its buffers have a static size. They
serve to compare, to port and to take apart. Arguments of gsplat that no stage supports are absent.
"""

from collections.abc import Callable
from dataclasses import replace
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int, Int32, Int64, Num

from rasterizer.arrays import takes_arrays
from rasterizer.binning import TileGrid, TilePairs, expand_boxes
from rasterizer.camera_models import CAMERA_MODELS, CameraModelName, Lens
from rasterizer.checks import absgrad_zeros, check_mode
from rasterizer.compositing import mask_tiles
from rasterizer.covariances import camera_rows, components, dot, matrix_rows, symmetric
from rasterizer.engines import Backend, blend
from rasterizer.ewa import Projection, camera_position
from rasterizer.projection import project
from rasterizer.rules import GSPLAT, Rules

PADDING = np.iinfo(np.int64).max  # The intersection id of a slot that holds none: sorts last.


@jax.tree_util.register_pytree_with_keys_class
class Info(dict[str, Any]):
    """Intermediate results by name: a pytree of the arrays of one call.

    gsplat's other keys are computed when they are read: `DERIVED`.
    """

    def __init__(self, arrays: dict[str, Any], grid: TileGrid):
        super().__init__(arrays)
        self.grid = grid

    def __missing__(self, name: str) -> Any:
        return DERIVED[name](self)

    def __contains__(self, name: object) -> bool:
        """Whether it can be read: a key of the lists needs the lists."""
        return super().__contains__(name) or (name in DERIVED and (name not in OF_LISTS or "splats" in self))

    def get(self, name: str, default: Any = None) -> Any:
        """Return the value, or `default` where the key cannot be read."""
        try:
            return self[name]
        except KeyError:
            return default

    def tree_flatten_with_keys(self):
        """The stored arrays are the children."""
        names = tuple(sorted(self))
        return [(jax.tree_util.DictKey(name), self[name]) for name in names], (names, self.grid)

    @classmethod
    def tree_unflatten(cls, static, children):
        """Inverse of `tree_flatten_with_keys`."""
        names, grid = static
        return cls(dict(zip(names, children, strict=True)), grid)


def _flatten_ids(info: Info) -> Array:
    """`[..., capacity]` int32 listed splats c * N + n, by tile and depth; -1 in slots left over."""
    splats, count = info["splats"], info["offsets"][..., -1:]
    return jnp.where(jax.lax.broadcasted_iota(jnp.int32, splats.shape, splats.ndim - 1) < count, splats, -1)


def _isect_offsets(info: Info) -> Array:
    """`[..., C, tile_height, tile_width]` int32: where each tile's run begins in `flatten_ids`."""
    first, grid = info["offsets"][..., :-1], info.grid
    return first.reshape(*first.shape[:-1], grid.num_cameras, grid.tiles_y, grid.tiles_x)


def _tiles_per_gauss(info: Info) -> Array:
    """`[..., C, N]` int32: the number of tiles that list each splat."""
    listed, shape = _flatten_ids(info), info["depths"].shape

    def count(listed: Array) -> Array:
        size = shape[-2] * shape[-1]
        return jnp.zeros(size, jnp.int32).at[jnp.where(listed >= 0, listed, size)].add(1, mode="drop")

    return jax.vmap(count)(listed.reshape(-1, listed.shape[-1])).reshape(shape)


DERIVED: dict[str, Callable[[Info], Any]] = {
    "width": lambda info: info.grid.width,
    "height": lambda info: info.grid.height,
    "n_cameras": lambda info: info.grid.num_cameras,
    "tile_size": lambda info: info.grid.tile_size,
    "tile_width": lambda info: info.grid.tiles_x,
    "tile_height": lambda info: info.grid.tiles_y,
    "camera_ids": lambda _: None,  # No rows are packed: gsplat has None, too.
    "gaussian_ids": lambda _: None,
    "tiles_per_gauss": _tiles_per_gauss,
    "isect_offsets": _isect_offsets,
    "flatten_ids": _flatten_ids,
}
OF_LISTS = "tiles_per_gauss", "isect_offsets", "flatten_ids"


@takes_arrays
def world_to_cam(
    means: Float[Array, "... N 3"], covars: Float[Array, "... N 3 3"], viewmats: Float[Array, "... C 4 4"]
) -> tuple[Float[Array, "... C N 3"], Float[Array, "... C N 3 3"]]:
    """Gaussians in the cameras' frames.

    Args:
        means: World frame.
        covars: World frame.
        viewmats: World to camera.

    Returns:
        Means and covariances.
    """
    viewmat = camera_rows(viewmats)
    mean = [part[..., None, :] for part in components(means)]
    rows = [[part[..., None, :] for part in row] for row in matrix_rows(covars)]
    turned = [[dot(viewmat[i], [rows[k][j] for k in range(3)]) for j in range(3)] for i in range(3)]
    both = [jnp.stack([dot(turned[i], viewmat[j]) for j in range(3)], -1) for i in range(3)]
    return jnp.stack(camera_position(mean, viewmat), -1), jnp.stack(both, -2)


@takes_arrays
def proj(
    means: Float[Array, "... C N 3"],
    covars: Float[Array, "... C N 3 3"],
    Ks: Float[Array, "... C 3 3"],
    width: int,
    height: int,
    camera_model: CameraModelName = "pinhole",
) -> tuple[Float[Array, "... C N 2"], Float[Array, "... C N 2 2"]]:
    """Affine projection of Gaussians that are in their cameras' frames.

    Args:
        means: Camera frame, in front of the camera.
        covars: Camera frame.
        Ks: Pixels.
        width: Image width, pixels: decides how far outside the image a pinhole's affine map is still followed.
        height: Image height, pixels.
        camera_model: "pinhole", "ortho" or "fisheye", as in `rasterization`.

    Returns:
        Means and covariances, pixels.

    Raises:
        ValueError: On another camera model.
    """
    check_mode(CameraModelName, camera_model=camera_model)
    lens, mean, rows = Lens(camera_rows(Ks)), components(means), matrix_rows(covars)
    identity = [[jnp.asarray(float(i == j), means.dtype) for j in range(3)] for i in range(3)]
    mean2d, *jacobian = CAMERA_MODELS[camera_model].image_point(mean, identity, lens, (width, height))
    spread = [[dot(row, step) for row in rows] for step in jacobian]
    covars2d = [jnp.stack([dot(a, b) for b in spread], -1) for a in jacobian]
    return jnp.stack(mean2d, -1), jnp.stack(covars2d, -2)


@takes_arrays
def fully_fused_projection(
    means: Float[Array, "... N 3"],
    covars: Float[Array, "... N 6"] | None,
    quats: Float[Array, "... N 4"] | None,
    scales: Float[Array, "... N 3"] | None,
    viewmats: Float[Array, "... C 4 4"],
    Ks: Float[Array, "... C 3 3"],
    width: int,
    height: int,
    eps2d: float = 0.3,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    *,
    calc_compensations: bool = False,
    camera_model: CameraModelName = "pinhole",
    opacities: Float[Array, "... N"] | None = None,
    rules: Rules = GSPLAT,
) -> tuple[
    Int32[Array, "... C N 2"],
    Float[Array, "... C N 2"],
    Float[Array, "... C N"],
    Float[Array, "... C N 3"],
    Float[Array, "... C N"] | None,
]:
    """Project Gaussians into cameras.

    Args:
        means: World frame.
        covars: Upper triangles (xx, xy, xz, yy, yz, zz), or None.
        quats: Rotations (w, x, y, z), or None with `covars`.
        scales: Standard deviations, or None with `covars`.
        viewmats: World to camera.
        Ks: Pixels.
        width: Image width, pixels. Static.
        height: Image height, pixels. Static.
        eps2d: Added to the 2D variances, pixels^2.
        near_plane: Gaussians at or nearer than this camera z are culled.
        far_plane: Gaussians at or beyond this camera z are culled.
        radius_clip: Gaussians whose radii are both at most this are culled, pixels.
        calc_compensations: Whether the antialiasing factors are returned.
        camera_model: "pinhole", "ortho" or "fisheye", as in `rasterization`.
        opacities: Where given, a faint Gaussian's radii shrink and one under the cut is culled.
        rules: Extents and alpha cut.

    Returns:
        Radii, 0 where culled; means2d, depths, conics, and compensations or None. Rows of culled Gaussians hold
        harmless values.

    Raises:
        ValueError: On another camera model, and where a Gaussian's shape is missing.
    """
    check_mode(CameraModelName, camera_model=camera_model)
    if opacities is None:
        rules = replace(rules, opacity_extent=False)
        opacities = jnp.ones(means.shape[:-1], means.dtype)
    if covars is not None:
        rows, _ = symmetric(components(covars))
        covars = jnp.stack([jnp.stack(row, -1) for row in rows], -2)
    mode = "antialiased" if calc_compensations else "classic"
    options = {"eps2d": eps2d, "near_plane": near_plane, "far_plane": far_plane, "radius_clip": radius_clip}
    options |= {"camera_model": camera_model, "rasterize_mode": mode, "rules": rules}

    def one_batch(means, covars, quats, scales, opacities, viewmats, Ks):
        shape = means, quats, scales, opacities, viewmats, Ks
        projection = project(*shape, width, height, covars=covars, **options)
        radii = jnp.ceil(projection.extents).astype(jnp.int32)
        return radii, projection.means2d, projection.depths, projection.conics, projection.compensations

    for _ in means.shape[:-2]:
        one_batch = jax.vmap(one_batch)
    return one_batch(means, covars, quats, scales, opacities, viewmats, Ks)


def _tile_bits(num_tiles: int) -> int:
    return max(num_tiles - 1, 0).bit_length()


@takes_arrays
def isect_tiles(
    means2d: Float[Array, "... N 2"],
    radii: Num[Array, "... N 2"],
    depths: Float[Array, "... N"],
    tile_size: int,
    tile_width: int,
    tile_height: int,
    sort: bool = True,
    *,
    capacity: int | None = None,
) -> tuple[Int32[Array, "... N"], Int64[Array, "n"], Int32[Array, "n"]]:
    """List the tiles that the box of each splat's radii overlaps.

    Args:
        means2d: Pixels.
        radii: Pixels; 0 along either axis lists nothing.
        depths: Positive.
        tile_size: Side of a tile, pixels.
        tile_width: Tiles per row.
        tile_height: Rows of tiles.
        sort: Whether the intersections are sorted by image, tile and depth.
        capacity: Length of the lists. None counts on the host, which `jit` cannot: there a number must be given;
            slots left over hold `PADDING` and -1, intersections beyond it are lost.

    Returns:
        Tiles per splat, intersection ids (image | tile | depth bits), and flattened splat indices. Not differentiable.

    Raises:
        ValueError: Inside `jit` without a capacity.
    """
    means2d, radii, depths = (jax.lax.stop_gradient(x) for x in (means2d, radii, depths))
    limit = jnp.broadcast_to(jnp.array([tile_width, tile_height], means2d.dtype), means2d.shape)
    reach = radii.astype(means2d.dtype)
    low = jnp.clip(jnp.floor((means2d - reach) / tile_size), 0, limit).astype(jnp.int32)
    high = jnp.clip(jnp.ceil((means2d + reach) / tile_size), 0, limit).astype(jnp.int32)
    size = jnp.where((radii > 0).all(-1, keepdims=True), high - low, 0)
    tiles_per_gauss = size[..., 0] * size[..., 1]

    if capacity is None:
        try:
            capacity = int(tiles_per_gauss.sum())
        except jax.errors.ConcretizationTypeError:
            raise ValueError("inside jit the number of intersections is not known: pass capacity=...") from None
    splat, tile_x, tile_y = expand_boxes(low.reshape(-1, 2), size.reshape(-1, 2), capacity)
    tile = tile_y * tile_width + tile_x
    bits = jax.lax.bitcast_convert_type(depths.astype(jnp.float32).reshape(-1), jnp.uint32)[splat]
    image = splat // max(means2d.shape[-2], 1)
    used = jnp.arange(capacity, dtype=jnp.int32) < tiles_per_gauss.sum()
    with jax.enable_x64(True):
        high_bits = (image.astype(jnp.int64) << _tile_bits(tile_width * tile_height)) | tile.astype(jnp.int64)
        ids = jnp.where(used, (high_bits << 32) | bits.astype(jnp.int64), PADDING)
        splat = jnp.where(used, splat, -1)
        if sort:
            ids, splat = jax.lax.sort((ids, splat), num_keys=1, is_stable=True)
    return tiles_per_gauss, ids, splat


@takes_arrays
def isect_offset_encode(
    isect_ids: Int64[Array, "n"], n_images: int, tile_width: int, tile_height: int
) -> Int32[Array, "{n_images} {tile_height} {tile_width}"]:
    """Where each tile's run starts in sorted intersection ids."""
    num_tiles = tile_width * tile_height
    with jax.enable_x64(True):
        image, tile = jnp.divmod(jnp.arange(n_images * num_tiles, dtype=jnp.int64), max(num_tiles, 1))
        first = ((image << _tile_bits(num_tiles)) | tile) << 32
        offsets = jnp.searchsorted(isect_ids, first).astype(jnp.int32)
    return offsets.reshape(n_images, tile_height, tile_width)


@takes_arrays
def rasterize_to_pixels(
    means2d: Float[Array, "... N 2"],
    conics: Float[Array, "... N 3"],
    colors: Float[Array, "... N D"],
    opacities: Float[Array, "... N"],
    image_width: int,
    image_height: int,
    tile_size: int,
    isect_offsets: Int[Array, "... tile_height tile_width"],
    flatten_ids: Int[Array, "n"],
    backgrounds: Float[Array, "... D"] | Float[Array, ""] | None = None,
    masks: Bool[Array, "... tile_height tile_width"] | None = None,
    *,
    absgrad: Float[Array, "... N 2"] | bool = False,
    backend: Backend = "auto",
    rules: Rules = GSPLAT,
) -> tuple[Float[Array, "... {image_height} {image_width} D"], Float[Array, "... {image_height} {image_width} 1"]]:
    """Blend listed splats.

    Args:
        means2d: Pixels.
        conics: Inverse 2D covariances (xx, xy, yy).
        colors: Any channels.
        opacities: In 0..1.
        image_width: Pixels. Static.
        image_height: Pixels. Static.
        tile_size: Side of a tile, pixels. Static.
        isect_offsets: Of `isect_offset_encode`.
        flatten_ids: Of `isect_tiles`.
        backgrounds: Blended under each image; a number for all channels.
        masks: A tile that is False is not rendered: background, alpha 0.
        absgrad: Zeros: the image does not depend on them, and their gradient is what gsplat's
            `absgrad=True` writes to `means2d.absgrad`.
        backend: A tile backend. Static.
        rules: Thresholds of compositing. Static.

    Returns:
        Image and alphas, differentiable to means2d, conics, colors, opacities and backgrounds.

    Raises:
        ValueError: On `absgrad` of another shape, and where there is no image or no channel.
    """
    probe = absgrad_zeros(absgrad, means2d.shape)
    images, count = means2d.shape[:-2], means2d.shape[-2]
    num_images = prod(images)
    grid = TileGrid(num_images, image_width, image_height, tile_size)
    total = jnp.sum(flatten_ids >= 0, dtype=jnp.int32)
    splats = jnp.maximum(flatten_ids, 0) if flatten_ids.size else jnp.zeros(1, jnp.int32)
    # In order and within the lists, whatever comes: the CPU's loops read what these say.
    offsets = jax.lax.cummax(jnp.clip(jnp.append(isect_offsets.reshape(-1), total), 0, total))
    pairs = TilePairs(splats, offsets, total, jnp.array(False))

    def flat(x: Array) -> Array:
        return x.reshape(num_images, count, *x.shape[means2d.ndim - 1 :])

    everywhere = jnp.ones((num_images, count), bool)
    projection = Projection(flat(means2d), flat(opacities), flat(conics), flat(means2d), everywhere)
    how = {"backend": backend, "absgrad": None if probe is None else flat(probe)}
    image, left, _ = mask_tiles(
        masks, *blend(projection, flat(opacities), flat(colors), pairs, grid, rules, **how), grid
    )
    if backgrounds is not None:
        behind = jnp.broadcast_to(backgrounds, (*images, colors.shape[-1]))
        image = image + left * behind.reshape(num_images, 1, 1, -1)
    shape = (*images, image_height, image_width)
    return image.reshape(*shape, image.shape[-1]), (1 - left).reshape(*shape, 1)
