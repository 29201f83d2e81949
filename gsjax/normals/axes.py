"""Foreign normal maps converted to our axes: x right, y down, z forward in the camera, towards it."""

import itertools
import re
from collections.abc import Iterable

import numpy as np

from gsjax.errors import InputError

NAMED_AXES = {"opencv": "+x+y+z", "opengl": "+x-y-z", "dsine": "-x-y-z", "pytorch3d": "-x-y+z"}
"""What networks and programs are known to write, as signs that convert it to our axes: opencv Omnidata, Metric3D and
MoGe's arrays; opengl Marigold and MoGe's pictures; dsine DSINE, StableNormal and Lotus."""

# The ways to mirror axes, up to the sign of the whole.
SIGN_PATTERNS = np.array([[1, 1, 1], [-1, 1, 1], [1, -1, 1], [1, 1, -1]], np.float32)


def axis_signs(axes: str) -> np.ndarray:
    """`[3]` float32 signs of axes written out (`+x-y-z`) or named (`NAMED_AXES`).

    Raises:
        InputError: They are neither.
    """
    match = re.fullmatch("([+-])x([+-])y([+-])z", NAMED_AXES.get(axes, axes))
    if match is None:
        raise InputError(f"normal_axes={axes}: expected three signs such as +x-y-z, or one of {', '.join(NAMED_AXES)}")
    return np.array([float(f"{sign}1") for sign in match.groups()], np.float32)


def written_axes(signs: np.ndarray) -> str:
    """The other way: `[3]` signs as `+x-y-z`."""
    return "".join(f"{'+' if s > 0 else '-'}{axis}" for s, axis in zip(signs, "xyz", strict=True))


# Every other way to turn the axes of a map, the whole negation last.
OTHER_SIGNS = np.array(list(itertools.product([1, -1], repeat=3))[1:], np.float32)
DECISIVE = 0.1  # |n . ray| of unit vectors, from which on a pixel says on which side its surface is seen.
STRIDE = 4  # Every so many pixels of a map are asked, in both directions.
FEWEST, MAJORITY = 100, 0.8  # Pixels that a verdict needs, and the share of them that it takes.


def facing_votes(normals: np.ndarray, K: np.ndarray) -> np.ndarray:
    """What a map alone says for its axes: a surface that is seen faces the camera.

    A pixel whose normal faces the camera as it is, and would not with other signs, speaks against those signs; one the
    other way round speaks for them; most say nothing. Against a mirrored x only surfaces to the left and right of the
    camera speak, against a mirrored y such above and below.

    Args:
        normals: `[H, W, 3]` unit, zero where there is none.
        K: `[3, 3]` pixels, centres at +0.5.

    Returns:
        `[7, 2]` counts for each of `OTHER_SIGNS`: pixels against it, pixels for it.
    """
    y, x = np.mgrid[0 : normals.shape[0] : STRIDE, 0 : normals.shape[1] : STRIDE] + 0.5
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    products = (normals[::STRIDE, ::STRIDE] * rays).reshape(-1, 3)
    as_it_is, otherwise = products.sum(axis=-1)[:, None], products @ OTHER_SIGNS.T
    against = (as_it_is < -DECISIVE) & (otherwise > DECISIVE)
    in_favour = (as_it_is > DECISIVE) & (otherwise < -DECISIVE)
    return np.stack([against.sum(axis=0), in_favour.sum(axis=0)], axis=-1)


def axes_verdict(votes: np.ndarray) -> str:
    """`facing_votes` of all maps, `[7, 2]`, as half a sentence about axes that are in question."""
    total = votes.sum(axis=-1)
    is_decisive = total >= FEWEST
    for_others = is_decisive & (votes[:, 1] > MAJORITY * total)
    for_these = is_decisive & (votes[:, 0] > MAJORITY * total)
    if for_others.any():
        # Of those that fit about as well, the one that mirrors least.
        best = for_others & (votes[:, 1] >= 0.9 * votes[for_others, 1].max())
        other = int(np.argmin(np.where(best, (OTHER_SIGNS < 0).sum(axis=-1), 4)))
        share = f"{votes[other, 1]:,} of the {total[other]:,} decisive pixels"
        return f"doubtful: mirrored by {written_axes(OTHER_SIGNS[other])} {share} would face the camera, as they must"
    if for_these.all():
        return "confirmed: any other mirroring would turn surfaces away from the camera"
    rest = ", ".join(written_axes(signs) for signs in OTHER_SIGNS[~for_these])
    return f"not contradicted; these views do not exclude a mirroring by {rest}"


def detect_axes(
    maps: Iterable[np.ndarray], references: Iterable[np.ndarray], *, pixels_per_map: int = 4000
) -> tuple[np.ndarray, float, float]:
    """Which axes of foreign normal maps point the other way: the mirroring that fits reference normals best.

    Maps are taken one at a time, a random sample of each is kept. They must show surfaces that face left or right: all
    else looks the same whichever way x points. So up to a third of the sample each is kept for surfaces that face
    sideways, up or down, and the camera; few walls at the side count as much as a floor that fills the view.

    Args:
        maps: `[H, W, 3]` each, any sign convention, zero where there is no normal.
        references: As many, of the same views in our convention, such as `depth_normals` of a trained scene.
        pixels_per_map: At most so many pixels of a map are compared.

    Returns:
        `[3]` signs (+1 or -1) for `apply_axes`, with the sign of the whole such that maps face the camera; the mean
        cosine that they reach, 0..1; and by how much the next best mirroring falls short of it. A score under 0.5 or
        a margin under 0.02 is doubtful; without a pixel to compare both are 0.
    """
    rng = np.random.default_rng(0)
    pairs = [_unit_pairs(m, r, pixels_per_map, rng) for m, r in zip(maps, references, strict=True)]
    products = np.concatenate([a * b for a, b in pairs])
    if not len(products):
        return SIGN_PATTERNS[0], 0.0, 0.0
    # Signs before the mean: where walls, floor and camera are upright, all mirrorings have the same |cos| everywhere.
    means = (products @ SIGN_PATTERNS.T).mean(axis=0)
    scores = np.abs(means)
    best = int(scores.argmax())
    facing = 1.0 if means[best] >= 0 else -1.0
    runner_up = np.delete(scores, best).max()
    return np.float32(facing) * SIGN_PATTERNS[best], float(scores[best]), float(scores[best] - runner_up)


def apply_axes(normals: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """A map `[H, W, 3]` with its axes turned by `[3]` signs, of the map's dtype."""
    return normals * signs.astype(normals.dtype)


def _unit_pairs(
    normals: np.ndarray, reference: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """`[P, 3]` float64 unit normals of both at no more than `count` of the pixels where both have one.

    No more than a third of them are where the reference's largest component is the same one.
    """
    both = np.flatnonzero(np.any(normals, axis=-1) & np.any(reference, axis=-1))
    largest = np.abs(reference.reshape(-1, 3)[both]).argmax(axis=-1)
    kinds = [both[largest == axis] for axis in range(3)]
    indices = np.concatenate([rng.choice(kind, min(count // 3, len(kind)), replace=False) for kind in kinds])
    pairs = [m.reshape(-1, 3)[indices].astype(np.float64) for m in (normals, reference)]
    lengths = [np.linalg.norm(p, axis=-1, keepdims=True) for p in pairs]
    long = (lengths[0][:, 0] > 0.5) & (lengths[1][:, 0] > 0.5)
    return pairs[0][long] / lengths[0][long], pairs[1][long] / lengths[1][long]
