"""Why depth that photos have taught lies too deep: each cause by itself, on a painted sphere.

    python experiments/too_deep.py --out DIR [--steps 600] [--seeds 1]

First, discs that lie where they should, spread evenly over a sphere, tangent, all of one size, thickness and opacity.
Learned are their colours and the radius of that sphere, so how far it ends from 1 is the fault of how discs are drawn:
nothing else can move. Every row changes one thing of the first. Photos count whole, or inside alone, where no outline
says where the sphere ends. Then Gaussians that are free in all, by steps.

Offsets are thousandths of the radius, negative where something lies too deep (`painted_sphere.offset`); a pixel in the
middle is 30 wide. `DIR/too_deep.md` has the tables.
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from painted_sphere import INTRINSICS, SIZE, VIEWS, Drawn, directions, inside, offset, paint, photo, viewmats
from tqdm import tqdm

import rasterizer
from gsjax.cli.parsers import count
from gsjax.measures.images import psnr, ssim

COUNT = 1500
SPACING = float(np.sqrt(4 * np.pi / COUNT))  # of the discs, radii
TILE, NEAREST = 8, 192  # pixels; splats that the pixels of a tile put in their own orders
BETWEEN = 0.2  # radians that cameras are turned by to score
MIP, CLASSIC = {"eps2d": 0.1, "rasterize_mode": "antialiased"}, {"eps2d": 0.3}


class Splats(NamedTuple):
    """Gaussians as the rasterizer takes them."""

    means: Array  # [N, 3]
    quats: Array  # [N, 4]
    log_scales: Array  # [N, 3]
    logit_opacities: Array  # [N]
    colors: Array  # [N, 3]


def in_tiles(splats: Splats, viewmat: Array, *, filtered: dict[str, Any], median: bool = False) -> Drawn:
    """As the library draws: in the order of the centres' depths."""
    image, alphas, info = rasterizer.rasterization(
        splats.means,
        splats.quats,
        jnp.exp(splats.log_scales),
        jax.nn.sigmoid(splats.logit_opacities),
        splats.colors,
        viewmat[None],
        jnp.asarray(INTRINSICS, jnp.float32)[None],
        SIZE,
        SIZE,
        render_mode="RGB+ED",
        depth_mode="plane",
        return_median_depth=median,
        capacity=16 * COUNT,
        **filtered,
    )
    depths = info["median_depths"][0, ..., 0] if median else image[0, ..., 3]
    return Drawn(image[0, ..., :3], alphas[0, ..., 0], depths)


def by_pixel(splats: Splats, viewmat: Array, *, filtered: dict[str, Any]) -> Drawn:
    """The same, but in the order of the depths at which the pixel's own ray meets the splats' planes."""
    opacities = jax.nn.sigmoid(splats.logit_opacities)
    cameras = viewmat[None], jnp.asarray(INTRINSICS, jnp.float32)[None], SIZE, SIZE
    shape = splats.means, splats.quats, jnp.exp(splats.log_scales), opacities
    seen = rasterizer.project(*shape, *cameras, depth_mode="plane", **filtered)
    if seen.compensations is not None:
        opacities = opacities * seen.compensations[0]
    at = jnp.arange(SIZE, dtype=jnp.float32) + 0.5
    x, y = (_tiles(axis) for axis in jnp.meshgrid(at, at))
    means = jax.lax.stop_gradient(jnp.where(seen.visible[0] & (opacities > 1 / 255), seen.means2d[0].T, jnp.inf))
    # Every tile's nearest splats: all that reach into it.
    far2 = jnp.square(x.mean(1)[:, None] - means[0]) + jnp.square(y.mean(1)[:, None] - means[1])
    _, near = jax.lax.top_k(-far2, NEAREST)
    near = jnp.where(jnp.isfinite(jnp.take_along_axis(far2, near, 1)), near, COUNT)

    def of_near(values: Array) -> Array:
        return jnp.take(values, near, axis=0, mode="fill", fill_value=0)[:, None]

    apart = jnp.stack([x, y], -1)[:, :, None] - of_near(seen.means2d[0])
    xx, xy, yy = jnp.moveaxis(of_near(seen.conics[0]), -1, 0)
    sigma = 0.5 * (xx * apart[..., 0] ** 2 + yy * apart[..., 1] ** 2) + xy * apart[..., 0] * apart[..., 1]
    alphas = jnp.minimum(of_near(opacities) * jnp.exp(-sigma), 0.999)
    alphas = jnp.where(alphas > 1 / 255, alphas, 0)
    depths = of_near(seen.depths[0]) + jnp.sum(apart * of_near(seen.slopes[0]), -1)
    order = jnp.argsort(jax.lax.stop_gradient(jnp.where(alphas > 0, depths, jnp.inf)), axis=2)
    colors = jnp.broadcast_to(of_near(splats.colors), (*alphas.shape, 3))
    alphas, depths = (jnp.take_along_axis(values, order, 2) for values in (alphas, depths))
    colors = jnp.take_along_axis(colors, order[..., None], 2)
    left = jnp.cumprod(1 - alphas, 2)
    weights = alphas * jnp.concatenate([jnp.ones_like(left[..., :1]), left[..., :-1]], 2)
    total = jnp.sum(weights, 2)
    depth = jnp.sum(weights * depths, 2) / jnp.maximum(total, 1e-6)
    return Drawn(_image(jnp.sum(weights[..., None] * colors, 2)), _image(total), _image(depth))


def _tiles(image: Array) -> Array:
    """`[tiles, pixels]` of `[H, W]`."""
    side = SIZE // TILE
    return image.reshape(side, TILE, side, TILE).swapaxes(1, 2).reshape(side**2, TILE**2)


def _image(tiles: Array) -> Array:
    """`[H, W, ...]` from `[tiles, pixels, ...]`."""
    side = SIZE // TILE
    return tiles.reshape(side, side, TILE, TILE, *tiles.shape[2:]).swapaxes(1, 2).reshape(SIZE, SIZE, *tiles.shape[2:])


def solid(draw: Callable[[Splats, Array], Drawn]) -> Callable[[Splats, Array], Drawn]:
    """Without the splats of the far side."""

    def of_near_side(splats: Splats, viewmat: Array) -> Drawn:
        center = -viewmat[:3, :3].T @ viewmat[:3, 3]
        faces = jnp.sum(splats.means * (center - splats.means), -1) > 0
        return draw(splats._replace(logit_opacities=jnp.where(faces, splats.logit_opacities, -20)), viewmat)

    return of_near_side


class Way(NamedTuple):
    """How discs are, and how they are drawn."""

    size: float = 0.4  # standard deviation, spacings
    thickness: float = 0.05  # sizes
    opacity: float = 0.99
    filtered: dict[str, Any] = {"eps2d": 1e-3}
    draw: Callable[..., Drawn] = in_tiles


BOUND = {
    "small, thin, opaque, hardly blurred": Way(),
    "larger: 0.6 spacings": Way(size=0.6),
    "the same, every pixel's own order": Way(size=0.6, draw=by_pixel),
    "larger: 0.9 spacings": Way(size=0.9),
    "the same, every pixel's own order ": Way(size=0.9, draw=by_pixel),
    "light passes: opacity 0.7": Way(opacity=0.7),
    "thick: half of their size": Way(thickness=0.5),
    "thick: balls": Way(thickness=1.0),
    "blur of 0.1, dimmed (mip)": Way(filtered=MIP),
    "blur of 0.3 (classic)": Way(filtered=CLASSIC),
    "0.6 spacings, opacity 0.7, half as thick, mip": Way(0.6, 0.5, 0.7, MIP),
}
FREE = {
    "as training has them": (Way(0.6, 0.5, 0.7, MIP), ()),
    "classic filter": (Way(0.6, 0.5, 0.7, CLASSIC), ()),
    "opaque (0.99) and staying so": (Way(0.6, 0.5, 0.99, MIP), ("logit_opacities",)),
    "tangent discs of one shape": (Way(0.6, 0.05, 0.7, MIP), ("log_scales", "quats")),
    "tangent, opaque discs of one shape": (Way(0.6, 0.05, 0.99, MIP), ("log_scales", "quats", "logit_opacities")),
}
"""How Gaussians begin, and which of their numbers stay."""


def discs(way: Way, radius: Array, colors: Array) -> Splats:
    """Tangent discs on a sphere, all alike; they grow with it."""
    normals = directions(COUNT)
    # The rotation that takes the z axis to the normal, w first; the lattice has no normal along -z.
    quats = np.stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(COUNT)], -1)
    scales = way.size * SPACING * np.array([1, 1, way.thickness])
    return Splats(
        radius * jnp.asarray(normals, jnp.float32),
        jnp.asarray(quats, jnp.float32),
        jnp.broadcast_to(jnp.log(radius * jnp.asarray(scales, jnp.float32)), (COUNT, 3)),
        jnp.full(COUNT, jax.scipy.special.logit(way.opacity)),
        colors,
    )


def fitted(start: Any, draw: Callable[[Any, Array], Drawn], rates: Any, steps: int, seed: int, *, whole: bool) -> Any:
    """Numbers after so many steps of Adam on 3DGS's loss over the photos; rates fall to a hundredth in the last third.

    Args:
        start: Numbers to begin with, a pytree.
        draw: (such numbers, viewmat) -> a picture.
        rates: Of every leaf.
        steps: How many.
        seed: Of the order of the photos.
        whole: Whether photos count whole, or inside alone.
    """
    falling = optax.join_schedules(
        [optax.constant_schedule(1.0), optax.exponential_decay(1.0, steps // 3, 0.01)], [2 * steps // 3]
    )
    optimizer = optax.multi_transform(
        {str(rate): optax.adam(lambda step, rate=rate: rate * falling(step)) for rate in jax.tree.leaves(rates)},
        jax.tree.map(str, rates),
    )

    def loss(numbers: Any, viewmat: Array, image: Array, mask: Array) -> Array:
        drawn = draw(numbers, viewmat).colors
        off = jnp.where(mask[..., None], drawn - image, 0)
        return 0.8 * jnp.mean(jnp.abs(off)) + 0.2 * (1 - ssim(drawn, image, mask))

    @jax.jit
    def step(numbers: Any, state: Any, *view: Array) -> tuple[Any, Any]:
        updates, state = optimizer.update(jax.grad(loss)(numbers, *view), state, numbers)
        return optax.apply_updates(numbers, updates), state

    cameras, rng = viewmats(), np.random.default_rng(seed)
    views = [(np.float32(each), np.float32(photo(each)), inside(each) | whole) for each in cameras]
    order = np.concatenate([rng.permutation(VIEWS) for _ in range(-(-steps // VIEWS))])[:steps]
    numbers, state = start, optimizer.init(start)
    for view in tqdm(order, leave=False):
        numbers, state = step(numbers, state, *views[view])
    return numbers


def decibels(draw: Callable[[Array], Drawn], views: np.ndarray) -> float:
    """PSNR of whole photos."""
    pairs = [(jnp.clip(draw(jnp.float32(view)).colors, 0, 1), jnp.float32(photo(view))) for view in views]
    return float(np.mean([psnr(*pair) for pair in pairs]))


def bound(way: Way, steps: int, seed: int, *, whole: bool) -> tuple[float, ...]:
    """Of discs on one sphere: offsets of their depth as placed, of the sphere that fits best, of the depth there."""
    draw, views = solid(partial(way.draw, filtered=way.filtered)), viewmats(BETWEEN)[::5]
    start = {"radius": jnp.ones(()), "colors": jnp.asarray(paint(directions(COUNT)), jnp.float32)}
    rates = {"radius": 1e-3, "colors": 0.01}
    found = fitted(start, lambda numbers, view: draw(discs(way, **numbers), view), rates, steps, seed, whole=whole)
    placed, after = (offset(jax.jit(partial(draw, discs(way, **each))), views) for each in (start, found))
    return placed, 1e3 * (float(found["radius"]) - 1), after


def free(way: Way, still: tuple[str, ...], steps: int, seed: int) -> tuple[float, ...]:
    """Of Gaussians that start near the sphere and move: offsets of mean depth, without the far side's, of median depth.

    And their PSNR.
    """
    rng, views = np.random.default_rng(seed), viewmats(BETWEEN)[::5]
    places = directions(COUNT) * (1 + 0.03 * rng.normal(size=(COUNT, 1)))
    begun = discs(way, jnp.ones(()), jnp.full((COUNT, 3), 0.5))._replace(means=jnp.asarray(places, jnp.float32))
    usual = {"means": 5e-4, "quats": 1e-3, "log_scales": 5e-3, "logit_opacities": 5e-2, "colors": 1e-2}
    rates = Splats(**{name: 0.0 if name in still else rate for name, rate in usual.items()})
    draw = partial(way.draw, filtered=way.filtered)
    found = fitted(begun, draw, rates, steps, seed, whole=True)
    ways = draw, solid(draw), partial(draw, median=True)
    return *(offset(jax.jit(partial(each, found)), views) for each in ways), decibels(partial(draw, found), views)


def rows(steps: int, seeds: int) -> Iterator[str]:
    """Lines of both tables, Markdown, as they are known: means over the seeds."""
    yield "| Discs of one kind | Depth as placed | Best sphere, inside | its depth | Best sphere, whole | its depth |"
    yield "|---" * 6 + "|"
    for name, way in BOUND.items():
        inner, outer = (
            np.mean([bound(way, steps, seed, whole=whole) for seed in range(seeds)], 0) for whole in (False, True)
        )
        yield f"| {name.strip()} | {inner[0]:.1f} | " + " | ".join(f"{x:.1f}" for x in (*inner[1:], *outer[1:])) + " |"
    yield ""
    yield "| Free Gaussians | Steps | Mean depth | without the far side's light | Median depth | PSNR |"
    yield "|---" * 6 + "|"
    for name, begun in FREE.items():
        for taken in (steps, 5 * steps):
            found = np.mean([free(*begun, taken, seed) for seed in range(seeds)], 0)
            yield f"| {name} | {taken} | " + " | ".join(f"{x:.1f}" for x in found) + " |"


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--seeds", type=count, default=1)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    lines: list[str] = []
    for line in rows(given.steps, given.seeds):
        print(line, flush=True)
        lines.append(line)
        (given.out / "too_deep.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
