"""The level set of the density on a grid: needs no view, shows both sides of every sheet of Gaussians."""

from collections.abc import Iterable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial import KDTree

from gsjax import density_field
from gsjax import gaussians as gs
from gsjax.cameras import Camera
from gsjax.density_field import Kernels
from gsjax.errors import NoSurfaceError
from gsjax.gaussians import Gaussians
from gsjax.io.machine import require_memory
from gsjax.meshes import Mesh
from gsjax.meshing import level_set
from gsjax.meshing.boxes import Box, Region
from gsjax.meshing.libraries import load_open3d
from gsjax.meshing.methods import Method, Sighting, base_colors, typical_scale
from gsjax.rendering.gallery import Picture

MOST_CELLS = 256  # Along the longest side of a region, where the size is chosen; SuGaR takes 512.
REACH = 3.0  # Standard deviations beyond which a Gaussian makes no density.
FLATTEST = 0.6  # Cells: a thinner Gaussian could pass between the samples unseen, so it counts as this thick.
BLOCK = 8  # Samples along the side of a block, in which a Gaussian is evaluated everywhere or nowhere.
BYTES_PER_SAMPLE = 12  # blocks, the grid made of them, and its copy for the surface
PAIRS = 2_048  # (Gaussian, block) evaluated at once: a bound of the memory.


def marching_cubes(*, level: float = 0.3, cell: float | None = None, min_opacity: float = 0.5) -> Method:
    """Surface where the density, sampled on a grid, crosses the level.

    Samples lie at the box's low corner plus whole multiples of the cell, and so do the vertices' indices: nothing is
    off by half a cell.

    Args:
        level: Density of the surface.
        cell: Distance of the samples, scene units. None: the median Gaussian's largest standard deviation in the
            region, or a 256th of the region's longest side where that is larger.
        min_opacity: Gaussians up to this make no density.
    """

    def gather(gaussians: Gaussians, cameras: Sequence[Camera], pictures: Iterable[Picture]) -> Sighting:
        kept = level_set.opaque_enough(gaussians, min_opacity, 1)
        centers = np.asarray(kept.means)

        def build(region: Region) -> tuple[Mesh, dict]:
            step = cell or max(typical_scale(kept, region), region.box.longest / MOST_CELLS)
            samples = density_grid(kept, region.box, step)
            vertices, faces = _isosurface(samples, level)
            if not len(faces):
                raise NoSurfaceError(f"no mesh: the density stays under {level} on a grid of {step:.4g}")
            vertices = (region.box.low + step * vertices).astype(np.float32)
            nearest = np.asarray(KDTree(centers).query(vertices, workers=-1)[1])
            return Mesh(vertices, faces, base_colors(kept)[nearest]), {"cell": step, "samples": samples.size}

        return Sighting(centers, build, {"kernels": len(centers)})

    return gather


def density_grid(gaussians: Gaussians, box: Box, step: float) -> np.ndarray:
    """`[Z, Y, X]` float32 density at `box.low + step * (x, y, z)`, from a little before to a little past the box's end.

    Gaussians count up to 3 standard deviations away, and as at least 0.6 steps thick.
    """
    thick = jnp.maximum(gaussians.log_scales, np.float32(np.log(FLATTEST * step)))
    field = density_field.kernels(gs.Gaussians(**{**gaussians.__dict__, "log_scales": thick}))
    counts = np.ceil((box.high - box.low) / (BLOCK * step)) + 1  # blocks along x, y, z
    require_memory(f"a grid of cells of {step:.3g} scene units", BYTES_PER_SAMPLE * BLOCK**3 * float(np.prod(counts)))
    counts = counts.astype(np.int64)
    low, high = _blocks_touched(np.asarray(gaussians.means), np.asarray(gs.rotation_matrices(gaussians.quats)),
                                np.exp(np.asarray(thick)), box, step, counts)  # fmt: skip
    spans = np.maximum(high - low, 0)
    ends = np.cumsum(np.prod(spans, axis=1))
    total = int(ends[-1])

    density = jnp.zeros((int(np.prod(counts)) + 1, BLOCK**3), jnp.float32)  # The last block takes the padding.
    for start in range(0, total, PAIRS):
        pair = np.arange(start, start + PAIRS)
        is_real = pair < total
        owner = np.searchsorted(ends, np.minimum(pair, total - 1), side="right")
        rest = np.minimum(pair, total - 1) - (ends[owner] - np.prod(spans[owner], axis=1))
        x, y, z = low[owner].T + np.array(_unravel(rest, spans[owner]))
        block = np.where(is_real, (z * counts[1] + y) * counts[0] + x, len(density) - 1)
        origin = box.low + step * BLOCK * np.stack([x, y, z], axis=-1)
        density = _add(density, field, owner, block, origin.astype(np.float32), jnp.float32(step))
    blocks = np.asarray(density)[:-1].reshape(*counts[::-1], BLOCK, BLOCK, BLOCK)
    return blocks.transpose(0, 3, 1, 4, 2, 5).reshape(counts[::-1] * BLOCK)


def _blocks_touched(means, axes, scales, box: Box, step: float, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`[N, 3]` first block and `[N, 3]` one past the last block that each Gaussian reaches; empty off the grid."""
    half = REACH * np.sqrt(np.sum((axes * scales[:, None, :]) ** 2, axis=-1))
    side = BLOCK * step
    low = np.floor((means - half - box.low) / side)
    high = np.floor((means + half - box.low) / side) + 1
    return np.clip(low, 0, counts).astype(np.int64), np.clip(high, 0, counts).astype(np.int64)


def _unravel(index: np.ndarray, spans: np.ndarray) -> list[np.ndarray]:
    """Coordinates of a running index in boxes of `spans` `[P, 3]` blocks, one box an index."""
    x, rest = index % spans[:, 0], index // spans[:, 0]
    return [x, rest % spans[:, 1], rest // spans[:, 1]]


@partial(jax.jit, donate_argnums=0)
def _add(density: Array, field: Kernels, owner: Array, block: Array, origin: Array, step: Array) -> Array:
    """`[B, BLOCK^3]` with the densities of P Gaussians (`owner`) added to the samples of P blocks."""
    z, y, x = jnp.meshgrid(*[jnp.arange(BLOCK, dtype=jnp.float32)] * 3, indexing="ij")
    offsets = step * jnp.stack([x, y, z], axis=-1).reshape(-1, 3)

    def of_pair(kernel: Kernels, start: Array) -> Array:
        alone = jax.tree.map(lambda leaf: leaf[None], kernel)
        return jax.vmap(lambda offset: density_field.density(start + offset, alone))(offsets)

    return density.at[block].add(jax.vmap(of_pair)(density_field.take(field, owner), origin))


def _isosurface(samples: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices `[V, 3]` in grid steps (x, y, z) and faces `[F, 3]`, outside where the samples are low."""
    o3d = load_open3d()
    surface = o3d.t.geometry.TriangleMesh.create_isosurfaces(o3d.core.Tensor(np.ascontiguousarray(samples)), [level])
    if not len(surface.triangle.indices):
        return np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    return surface.vertex.positions.numpy(), surface.triangle.indices.numpy().astype(np.int32)
