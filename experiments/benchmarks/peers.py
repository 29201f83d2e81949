"""Rasterizers that `rasterizer_peers.py` times: what each does with the splats of one view, forward and with gradients.

* `jnp`: our own engine in jnp, `backend="xla"`.
* `gsplat`: the blending of gsplat's torch reference, `gsplat.cuda._torch_impl.accumulate`, with autograd. It makes no
  lists of who meets which pixel (its CUDA kernels do) and sums along rays by nerfacc, CUDA too. So the lists are made
  before the clock starts, and the sums are torch's: what is timed of it is less than what is timed of ours.

`hard_cases_gsplat.py` renders with the same lists and sums.
"""

import sys
from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Any, NamedTuple

from gsjax.errors import InputError

TILE = 8  # pixels

Task = Callable[[], Any]


class Splats(NamedTuple):
    """Projected splats of one view, and where ours puts them."""

    projection: Any  # of one camera
    opacities: Any  # [N]
    colors: Any  # [N, 3]
    grid: Any  # of tiles
    pairs: Any  # the splats of every tile, front to back


class Peer(NamedTuple):
    """Another rasterizer."""

    rules: Any  # thresholds that it has; ours takes them on
    tasks: Callable[[Splats], tuple[Task, Task]]  # the image [H, W, 3] of splats, and the gradient of its squares' sum


def peer_named(name: str) -> Peer:
    """The other rasterizer of a name.

    Raises:
        InputError: gsplat is not installed.
    """
    return {"jnp": _jnp, "gsplat": _gsplat}[name]()


def tasks_of_ours(splats: Splats, *, backend: Any, rules: Any) -> tuple[Task, Task]:
    """One of our backends: it bins and blends."""
    import jax
    import jax.numpy as jnp

    import rasterizer

    grid, capacity = splats.grid, len(splats.pairs.splats)
    inputs = splats.projection.means2d, splats.projection.conics, splats.opacities, splats.colors

    # All that is known of the splats is an argument: a compiler sorts constants before the clock starts.
    def image(inputs, projection):
        means2d, conics, opacities, colors = inputs
        placed = projection._replace(means2d=means2d, conics=conics)
        pairs = rasterizer.bin_splats(placed, opacities, grid, capacity, rules, backend=backend)
        return rasterizer.blend(placed, opacities, colors[None], pairs, grid, rules, backend=backend)[0][0]

    compiled = jax.jit(image), jax.jit(jax.grad(lambda *arguments: jnp.sum(image(*arguments) ** 2)))
    return tuple(lambda run=run: jax.block_until_ready(run(inputs, splats.projection)) for run in compiled)  # pyright: ignore[reportReturnType]


def _jnp() -> Peer:
    import rasterizer

    return Peer(rasterizer.GSPLAT, partial(tasks_of_ours, backend="xla", rules=rasterizer.GSPLAT))


def _gsplat() -> Peer:
    """It blends, along lists of pixels and splats that are there already."""
    import rasterizer

    try:
        import torch
        from gsplat.cuda import _torch_impl as reference
    except ImportError as error:
        raise InputError(f"gsplat: {error}: pip install gsplat torch") from None
    sys.modules["nerfacc"] = sums_along_rays(torch)  # gsplat imports it by name when it blends

    def tasks(splats: Splats) -> tuple[Task, Task]:
        import numpy as np

        projection, grid = splats.projection, splats.grid
        placed, listed = (projection.means2d[0], projection.conics[0], splats.opacities), splats.pairs
        ids, pixels = map(torch.tensor, pixel_pairs(*placed, grid, listed.offsets, listed.splats))
        arrays = projection.means2d, projection.conics, splats.opacities[None], splats.colors[None]
        inputs = [torch.tensor(np.array(each), requires_grad=True) for each in arrays]
        only = torch.zeros_like(ids)

        def blended():
            return reference.accumulate(*inputs, ids, pixels, only, grid.width, grid.height)[0][0]

        def image():
            with torch.no_grad():
                return blended()

        return image, lambda: torch.autograd.grad((blended() ** 2).sum(), inputs)

    return Peer(rasterizer.GSPLAT_1_5, tasks)


def pixel_pairs(means2d: Any, conics: Any, opacities: Any, grid: Any, offsets: Any, listed: Any):
    """The pairs of a splat and a pixel that gsplat's kernel `rasterize_to_indices` lists, in float64.

    `[N, 2]` means in pixels, `[N, 3]` conics, `[N]` opacities, the grid of one image, `[T + 1]` offsets of its tiles in
    `[P]` listed splats -> `[M]` splats and `[M]` pixels, counted row by row: pixel by pixel, front to back.
    """
    import numpy as np

    import rasterizer

    rules = rasterizer.GSPLAT_1_5
    means2d, conics, opacities = (np.asarray(each, np.float64) for each in (means2d, conics, opacities))
    offsets, listed = np.asarray(offsets), np.asarray(listed)
    rows, columns = np.indices((grid.tile_size, grid.tile_size)).reshape(2, -1)
    per_tile = []
    for tile in range(grid.num_tiles):
        ids = listed[offsets[tile] : offsets[tile + 1]]
        column, row = tile % grid.tiles_x, tile // grid.tiles_x
        across, down = column * grid.tile_size + columns, row * grid.tile_size + rows
        inside = (across < grid.width) & (down < grid.height)
        away_x, away_y = across[inside, None] + 0.5 - means2d[ids, 0], down[inside, None] + 0.5 - means2d[ids, 1]
        a, b, c = conics[ids].T
        sigmas = 0.5 * (a * away_x**2 + c * away_y**2) + b * away_x * away_y
        with np.errstate(over="ignore"):
            alphas = np.fmin(opacities[ids] * np.exp(-sigmas), rules.alpha_max)  # CUDA's min: the other one of a NaN
        alphas = np.where((sigmas < 0) | (alphas < rules.alpha_min), 0, alphas)
        is_drawn = (alphas > 0) & (np.cumprod(1 - alphas, -1) > rules.transmittance_min)
        pixel, place = np.nonzero(is_drawn)
        per_tile.append((ids[place], (down[inside] * grid.width + across[inside])[pixel]))
    ids, pixels = (np.concatenate(each).astype(np.int64) for each in zip(*per_tile, strict=True))
    order = np.argsort(pixels, kind="stable")
    return ids[order], pixels[order]


def sums_along_rays(torch: Any) -> ModuleType:
    """The two functions of nerfacc that gsplat's reference calls, for samples in the order of their rays."""

    def render_weight_from_alpha(alphas, *, ray_indices, n_rays):
        del n_rays
        # In float64: one running sum over all rays would cost the last ones their digits.
        log_transmittances = torch.cumsum(torch.log1p(-alphas.double()), 0)
        before = log_transmittances - torch.log1p(-alphas.double())
        first = torch.searchsorted(ray_indices, ray_indices)
        transmittances = torch.exp(before - before[first]).to(alphas.dtype)
        return transmittances * alphas, transmittances

    def accumulate_along_rays(weights, values, *, ray_indices, n_rays):
        weighted = weights[:, None] if values is None else weights[:, None] * values
        return weighted.new_zeros(n_rays, weighted.shape[-1]).index_add(0, ray_indices, weighted)

    module = ModuleType("nerfacc")
    module.__dict__.update(
        render_weight_from_alpha=render_weight_from_alpha, accumulate_along_rays=accumulate_along_rays
    )
    return module
