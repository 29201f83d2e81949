"""Pairs of photos that are worth matching, by a quick comparison of few features of each."""

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from gsjax.io.parallel_map import Progress, map_with_bar
from gsjax.io.sfm.features import Features, match
from gsjax.io.sfm.gps import Fix

Pair = tuple[int, int]  # photos by their place in the list, the smaller first

_FEW_FEATURES = 400  # the largest of each photo, for the first look
_PARTNERS = 20  # photos that each is matched with
_NEAREST_BY_GPS = 10  # photos taken nearest to each, which a walk's few features in common may not tell
_NEXT_BY_NAME = 3  # photos that follow in name order: mostly, and in a video always, the next ones taken


def likeness(features: list[Features], progress: Progress) -> np.ndarray:
    """Return `[V, V]` int: how many of their few largest features two photos have in common; 0 on the diagonal."""
    few = [one.unit(_FEW_FEATURES) for one in features]
    count = len(few)

    def compare(i: int) -> list[int]:
        return [len(match(few[i], few[j], nearness=features[i].nearness)) for j in range(i + 1, count)]

    rows = map_with_bar(compare, range(count), progress, "first look", "photo")
    scores = np.array([[0] * (count - len(row)) + row for row in rows], np.int64)
    return scores + scores.T


def choose_pairs(scores: np.ndarray) -> set[Pair]:
    """Return the pairs to match: each photo with those of most `likeness`, and with those next in the list, by name."""
    everything = range(len(scores))
    following = {(i, j) for i, j in combinations(everything, 2) if j - i <= _NEXT_BY_NAME}
    return following | likeliest_pairs(scores, everything, everything, set())


def nearby_pairs(fixes: Sequence[Fix | None]) -> set[Pair]:
    """Return the pairs of each photo with those taken nearest to it by GPS; heights, which err most, are ignored."""
    having = [photo for photo, fix in enumerate(fixes) if fix is not None]
    if len(having) < 2:
        return set()
    degrees = np.array([fix[:2] for fix in fixes if fix is not None])
    latitude, longitude = np.radians(degrees).T
    on_globe = np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1
    )
    _, nearest = KDTree(on_globe).query(on_globe, k=range(1, min(_NEAREST_BY_GPS + 1, len(having)) + 1))
    pairs = ((having[i], having[j]) for i, row in enumerate(nearest) for j in row if i != j)
    return {(min(pair), max(pair)) for pair in pairs}


def likeliest_pairs(scores: np.ndarray, photos: Iterable[int], among: Iterable[int], attempts: set[Pair]) -> set[Pair]:
    """Return for each of `photos` the pairs with those `among` others most like it, without those of `attempts`."""
    among = np.fromiter(among, np.int64)
    pairs = set()
    for i in photos:
        ranked = among[np.argsort(-scores[i, among], kind="stable")]
        new = [pair for j in ranked.tolist() if i != j and (pair := (min(i, j), max(i, j))) not in attempts]
        pairs |= set(new[:_PARTNERS])
    return pairs


def bridging_pairs(scores: np.ndarray, matched: Iterable[Pair], attempts: set[Pair]) -> set[Pair]:
    """Return pairs that may join connected parts: photos outside the largest part, with those of other parts."""
    rows, columns = np.array(list(matched), np.int64).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=scores.shape)
    parts = connected_components(graph, directed=False)[1]  # [V]
    largest = np.bincount(parts).argmax()
    pairs = set()
    for part in np.unique(parts[parts != largest]):
        pairs |= likeliest_pairs(
            scores, np.flatnonzero(parts == part).tolist(), np.flatnonzero(parts != part), attempts
        )
    return pairs
