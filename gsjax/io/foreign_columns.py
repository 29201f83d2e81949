"""Columns that other programs add to PLY files of Gaussians: fused, refused or named."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.messages import print_once

KNOWN = re.compile(r"[xyz]|n[xyz]|f_dc_[0-2]|f_rest_\d+|opacity|scale_[0-2]|rot_[0-3]|red|green|blue|alpha")
FILTER = re.compile("filter_?3d", re.IGNORECASE)  # of Mip-Splatting, GOF, RaDe-GS and MILo.
CHANGING = {  # What columns mean without which the others are no Gaussians as they are here.
    "Gaussians that move or fade over time": r"t|scal(e|ing)_t|rot_r_\d+|motion_\d+|omega_\d+|trbf_(center|scale)",
    "kernels other than Gaussians": r"beta|shape|nu(_degree)?",
    "colours other than spherical harmonics": r"s[gb]_\w+",
    "anchors of a network": r"f_offset_\d+|f_anchor_feat_\d+",
}


def filter_column(path: Path, names: Iterable[str]) -> str | None:
    """The column of 3D filters that a file has, if any; a line names columns that are not read.

    InputError names columns that change what the others mean.
    """
    foreign = [name for name in names if not KNOWN.fullmatch(name)]
    for what, pattern in CHANGING.items():
        if changing := [name for name in foreign if re.fullmatch(pattern, name.lower())]:
            raise InputError(f"{path}: holds {what} ({', '.join(_grouped(changing))}), which are not read")
    filters = [name for name in foreign if FILTER.fullmatch(name)]
    report_unread(path, [name for name in foreign if name not in filters])
    return filters[0] if filters else None


def report_unread(path: Path, names: Sequence[str]) -> None:
    """Names columns that are not read, if any, in one line."""
    if names:
        print_once(f"{path}: columns that are not read: {', '.join(_grouped(names))}")


def _grouped(names: Sequence[str]) -> list[str]:
    """The names, where a series that differs by its last numbers is one: `label_*`."""
    stems = [re.sub(r"\d+$", "*", name) for name in names]
    return list(dict.fromkeys(s if stems.count(s) > 1 else n for s, n in zip(stems, names, strict=True)))


def fuse_filter(log_scales: np.ndarray, logits: np.ndarray, filters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log scales and logits, float32, smoothed by an isotropic 3D filter each (Mip-Splatting, arXiv:2311.16493, eq. 9).

    Variances grow by that of the filter, and opacities shrink by the root of the determinants' ratio.

    Args:
        log_scales: `[N, K]` logs of the deviations along the axes.
        logits: `[N, 1]` of the opacities.
        filters: `[N, 1]` deviations of the filters, scene units.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        before = log_scales.astype(np.float64)
        after = np.logaddexp(2 * before, 2 * np.log(np.abs(filters.astype(np.float64)))) / 2
        log_ratio = (before - after).sum(axis=1, keepdims=True)
        log_opacity, log_rest = -np.logaddexp(0, -logits.astype(np.float64)), -np.logaddexp(0, logits)
        # What remains transparent: 1 - ratio * opacity, without the loss of digits where both are near 1.
        transparent = np.exp(log_rest) - np.exp(log_opacity) * np.expm1(log_ratio)
        fused = log_opacity + log_ratio - np.log(transparent)
        return after.astype(np.float32), fused.astype(np.float32)
