"""Vector quantization: codebooks of 256 values, and palettes of rows by k-means."""

import heapq
import math
import warnings

import numpy as np
from scipy.cluster.vq import kmeans2, vq
from tqdm import tqdm

SIZE = 256  # of a codebook: its labels are bytes
_QUIET = 3.0  # Seconds of clustering that need no bar.
_LEARNED_FROM = 2**15  # Rows that tell the coarse clusters.
_COARSE_ROUNDS, _FINE_ROUNDS = 6, 4  # of Lloyd's iteration
_BLOCK = 2**14  # Rows that are compared with the coarse clusters at a time.


def codebook(values: np.ndarray) -> np.ndarray:
    """256 sorted values that represent all, float32; the very values where these are no more than 256.

    The range with the largest squared error about its mean is split at that mean until there are 256 (the median cut
    of Heckbert 1982, in one dimension). A far value costs one entry, however far it is.
    """
    ordered = np.sort(np.asarray(values, np.float64), axis=None)
    if not len(ordered):
        return np.zeros(SIZE, np.float32)
    ranges = [(_negative_error(ordered), 0, len(ordered))]
    while len(ranges) < SIZE and ranges[0][0] < 0:
        _, start, end = heapq.heappop(ranges)
        part = ordered[start:end]
        cut = start + int(np.clip(np.searchsorted(part, part.mean(), "right"), 1, len(part) - 1))
        for half in ((start, cut), (cut, end)):
            heapq.heappush(ranges, (_negative_error(ordered[slice(*half)]), *half))
    # Rounding may bring the mean of equal values to another one.
    means = [np.clip(ordered[start:end].mean(), ordered[start], ordered[end - 1]) for _, start, end in ranges]
    entries = np.sort(means).astype(np.float32)
    return np.pad(entries, (0, SIZE - len(entries)), mode="edge")


def nearest_labels(values: np.ndarray, entries: np.ndarray) -> np.ndarray:
    """The index of the nearest of sorted `entries` for every value, uint8 of the same shape."""
    entries = entries.astype(np.float64)
    return np.searchsorted((entries[1:] + entries[:-1]) / 2, values).astype(np.uint8)


def palette(rows: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """At most so many rows that represent all `[N, D]` float32, by k-means in two levels; all where they are no more.

    Returns:
        `[M, D]` float32, and `[N]` int64, which of them represents each.
    """
    if len(rows) <= most:
        return rows, np.arange(len(rows))
    random = np.random.default_rng(0)
    coarse = _clustered(_some(rows, _LEARNED_FROM, random), math.isqrt(most), _COARSE_ROUNDS, random)[0]
    owners = np.concatenate([vq(rows[i : i + _BLOCK], coarse)[0] for i in range(0, len(rows), _BLOCK)])
    centers, labels, count = [], np.empty(len(rows), np.int64), 0
    for index in tqdm(range(len(coarse)), desc="palette", unit="cluster", delay=_QUIET):
        members = np.flatnonzero(owners == index)
        if not len(members):
            continue
        room = 1 + (most - len(coarse)) * len(members) // len(rows)
        own, inner = _clustered(rows[members], room, _FINE_ROUNDS, random)
        centers.append(own)
        labels[members] = count + inner
        count += len(own)
    return np.concatenate(centers), labels


def _clustered(rows: np.ndarray, count: int, rounds: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Lloyd's iteration from some of the rows: centroids, and the label of each row."""
    if len(rows) <= count:
        return rows, np.arange(len(rows))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "One of the clusters is empty")  # It stays where it began.
        centroids, labels = kmeans2(rows, _some(rows, count, random), iter=rounds, minit="matrix")
    return centroids.astype(np.float32), labels


def _some(rows: np.ndarray, count: int, random: np.random.Generator) -> np.ndarray:
    return rows if len(rows) <= count else rows[random.choice(len(rows), count, replace=False)]


def _negative_error(ordered: np.ndarray) -> float:
    """Minus the squared error of sorted values about their mean: what a heap has first is split first."""
    return -float(np.var(ordered)) * len(ordered) if ordered[0] < ordered[-1] else 0.0
