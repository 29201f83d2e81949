"""A sphere of radius 1 with a smooth pattern before black, cameras around it, and how far a rendered surface is off.

Where light falls and where the surface is are known in closed form, and nothing but the photos says so.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

SIZE, FOCAL, DISTANCE, VIEWS, RAYS = 64, 100.0, 4.0, 40, 4  # pixels, pixels, radii, cameras, rays a side of a pixel
INTRINSICS = np.array([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]])
WAVES, SHORTEST, LONGEST = 6, 0.2, 0.35  # of every channel's pattern; lengths, radii
STEEPEST = 60.0  # degrees between ray and normal of what counts as inside


class Drawn(NamedTuple):
    """A picture of Gaussians."""

    colors: Array  # [H, W, 3]
    alphas: Array  # [H, W]
    depths: Array  # [H, W]


def directions(count: int) -> np.ndarray:
    """`[count, 3]` unit vectors, spread evenly (a Fibonacci lattice)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    return np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], -1)


def viewmats(turned: float = 0.0) -> np.ndarray:
    """`[VIEWS, 4, 4]` of cameras that look at the middle, all turned about it by so many radians."""
    axis = np.array([[np.cos(turned), 0, np.sin(turned)], [0, 1, 0], [-np.sin(turned), 0, np.cos(turned)]])
    forward = -directions(VIEWS) @ axis.T
    right = np.cross(forward, np.roll(forward, 1, -1) + 0.3)
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    found = np.tile(np.eye(4), (VIEWS, 1, 1))
    found[:, :3, :3], found[:, 2, 3] = np.stack([right, np.cross(forward, right), forward], 1), DISTANCE
    return found


def paint(points: np.ndarray) -> np.ndarray:
    """`[..., 3]` colours of points of the sphere."""
    rng = np.random.default_rng(0)
    waves = rng.normal(size=(3, WAVES, 3))
    lengths = rng.uniform(SHORTEST, LONGEST, (3, WAVES, 1))
    waves *= 2 * np.pi / (np.linalg.norm(waves, axis=-1, keepdims=True) * lengths)
    phases = rng.uniform(0, 2 * np.pi, (3, WAVES))
    return np.clip(0.5 + 0.6 * np.sin(np.einsum("...k,cwk->...cw", points, waves) + phases).mean(-1), 0, 1)


def rays(viewmat: np.ndarray, fine: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """The camera's centre `[3]`, and rays of depth 1, `[SIZE fine, SIZE fine, 3]`; world."""
    at = (np.arange(SIZE * fine) + 0.5) / fine
    x, y = np.meshgrid((at - SIZE / 2) / FOCAL, (at - SIZE / 2) / FOCAL)
    return -viewmat[:3, :3].T @ viewmat[:3, 3], np.stack([x, y, np.ones_like(x)], -1) @ viewmat[:3, :3]


def depth(viewmat: np.ndarray, fine: int = 1) -> np.ndarray:
    """`[SIZE fine, SIZE fine]` true depth, 0 where there is no sphere."""
    center, ray = rays(viewmat, fine)
    along, squared = ray @ center, np.sum(ray**2, -1)
    left = along**2 - squared * (center @ center - 1)
    return np.where(left > 0, (-along - np.sqrt(left.clip(0))) / squared, 0)


def photo(viewmat: np.ndarray) -> np.ndarray:
    """`[SIZE, SIZE, 3]` means of the light over the pixels."""
    center, ray = rays(viewmat, RAYS)
    at = depth(viewmat, RAYS)[..., None]
    light = np.where(at > 0, paint(center + at * ray), 0)
    return light.reshape(SIZE, RAYS, SIZE, RAYS, 3).mean((1, 3))


def inside(viewmat: np.ndarray) -> np.ndarray:
    """`[SIZE, SIZE]` bool: pixels that see the sphere, and not too steeply."""
    center, ray = rays(viewmat)
    at = depth(viewmat)
    facing = -np.sum((center + at[..., None] * ray) * ray, -1) / np.linalg.norm(ray, axis=-1)
    return (at > 0) & (facing > np.cos(np.radians(STEEPEST)))


def offset(draw: Callable[[Array], Drawn], views: np.ndarray) -> float:
    """How far outside of the sphere the points at a rendering's depth lie, thousandths of its radius: the median.

    Args:
        draw: viewmat `[4, 4]` -> a picture.
        views: `[V, 4, 4]` viewmats.
    """
    found = []
    for viewmat in views:
        center, ray = rays(viewmat)
        drawn = draw(jnp.asarray(viewmat, jnp.float32))
        points = center + np.asarray(drawn.depths, np.float64)[..., None] * ray
        seen = inside(viewmat) & (np.asarray(drawn.alphas) > 0.5)
        found.append(np.linalg.norm(points[seen], axis=-1) - 1)
    return 1e3 * float(np.median(np.concatenate(found)))
