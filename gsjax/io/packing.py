"""What compressed files of Gaussians share: opacities in 8 bits, rotations by the smallest components, an order."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.special import expit, logit

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians

MOST_DEGREE = 3  # Of the harmonics that viewers read from compressed files.


def check_packable(path: str | Path, gaussians: Gaussians) -> None:
    """Raises InputError where values are not finite, or harmonics of too high a degree for a compressed file.

    Infinite logits of opacities are 0 and 1.
    """
    for field in fields(gaussians):
        values = getattr(gaussians, field.name)
        if isinstance(values, str):
            continue
        fine = ~np.isnan(values) if field.name == "logit_opacities" else np.isfinite(values)
        broken = ~fine.all(axis=tuple(range(1, fine.ndim)))
        if broken.any():
            raise InputError(f"cannot write {path}: {field.name} of {broken.sum()} of {len(fine)} Gaussians not finite")
    if gaussians.sh_degree > MOST_DEGREE:
        raise InputError(
            f"cannot write {path}: it holds harmonics up to degree {MOST_DEGREE}, not {gaussians.sh_degree}; "
            f"sh_degree={MOST_DEGREE} leaves out the rest"
        )


def packed_gaussians(path: Path, **values: Any) -> Gaussians:
    """The Gaussians of a packed file, float32, of their fields as arrays of any float."""
    with np.errstate(over="ignore"):
        read = jax.tree.map(lambda array: array.astype(np.float32), Gaussians(**values))
    if not all(np.isfinite(array).all() for array in jax.tree.leaves(read)):
        raise InputError(f"{path}: holds numbers beyond what float32 holds")
    return read


def pull_in_outliers(means: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """`[N, 3]` positions of which a far one takes no precision from the others, and `[N]` bool, which of them came in.

    The mass are those within `reach` times the distance that nine tenths keep from the middle, the distance being the
    largest along an axis. What is farther away comes in towards the middle, to the edge of the box of the mass.
    """
    if not len(means):
        return means, np.zeros(0, bool)
    middle = np.median(means, axis=0)
    offsets = means - middle
    distances = np.abs(offsets).max(axis=1)
    spread = np.quantile(distances, 0.9)
    far = (distances > reach * spread) & (spread > 0)
    mass, moved = means[~far], means.copy()
    shares = distances[~far].max() / distances[far]
    moved[far] = np.clip(middle + shares[:, None] * offsets[far], mass.min(axis=0), mass.max(axis=0))
    return moved, far


def morton_order(means: np.ndarray) -> np.ndarray:
    """`[N]` indices that sort positions along a Z-order curve."""
    low, span = means.min(axis=0, initial=np.inf), np.ptp(means, axis=0) if len(means) else np.ones(3)
    cells = ((means - low) / np.where(span > 0, span, 1) * (2**21 - 1)).astype(np.uint64)
    codes = np.zeros(len(means), np.uint64)
    for bit in range(21):
        for axis in range(3):
            codes |= (cells[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(codes, kind="stable")


def opacity_bytes(logits: np.ndarray) -> np.ndarray:
    """The nearest of 256 opacities, uint8, of logits of any size."""
    return np.rint(255 * expit(np.asarray(logits, np.float64))).astype(np.uint8)


def logits_of_bytes(opacities: np.ndarray) -> np.ndarray:
    """Finite logits of 256 opacities: 0 and 255 are a quarter of a step within 0 and 1, and become themselves again."""
    return logit(np.clip(opacities.astype(np.float64), 0.25, 254.75) / 255)


def unit_quats(quats: np.ndarray) -> np.ndarray:
    """`[N, 4]` float64 quaternions of length 1; the identity where they are zero, as the renderer has it."""
    quats = np.asarray(quats, np.float64)
    length = np.linalg.norm(quats, axis=1, keepdims=True)
    is_zero = length < 1e-12
    return np.where(is_zero, [1.0, 0.0, 0.0, 0.0], quats / np.where(is_zero, 1, length))


def smallest_three(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`[N]` which component of each unit quaternion `[N, 4]` is the largest, and `[N, 3]` the others in order.

    The sign is the one that makes the largest positive, so the others, at most sqrt(1/2) each, determine the rotation.
    """
    largest = np.argmax(np.abs(quats), axis=1)
    others = np.arange(4) != largest[:, None]
    signs = np.where(quats[~others] < 0, -1, 1)[:, None]
    return largest, signs * quats[others].reshape(-1, 3)


def of_smallest_three(largest: np.ndarray, three: np.ndarray) -> np.ndarray:
    """`[N, 4]` quaternions of what `smallest_three` gives."""
    others = np.arange(4) != largest[:, None]
    quats = np.empty((len(largest), 4))
    quats[others] = three.ravel()
    quats[~others] = np.sqrt(np.maximum(0, 1 - np.sum(three * three, axis=1)))
    return quats
