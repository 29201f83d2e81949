"""Photo and point effects of the colours along tracks: a linear table with holes, fitted robustly.

log colour = point + gain(photo) + noise. Of two photos that see one point, whatever the point's colour, the difference
is theirs. The points are eliminated, so a fit is one dense system of the size of the photos (after Park et al., CVPR
2016, who fit sparse correspondences in log space).
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from gsjax.effects.observations import Observations
from gsjax.scene.colors import srgb_to_linear

ROUNDS = 10  # of reweighting
OUTLIER = 1.5  # standard deviations beyond which a residual counts linearly (Huber)
SHORTEST_TRACK = 3
SHARED = 10  # observations of a photo err alike, because neighbouring keypoints are on one surface
_FEWEST = 20  # observations of a photo in each half of the scene, to be compared
_PULL = 1e-3  # observations of gain zero that every photo has in addition to its own: decides where nothing else does
_GREY_AND_TINTS = np.array([[1, 1, 1], [1, -1, 0], [1, 1, -2]]).T / np.sqrt([3, 2, 6])  # orthonormal columns


class Table(NamedTuple):
    """N logarithms of colours, by photo and by point."""

    values: np.ndarray  # [N, C]
    photo: np.ndarray  # [N] 0..V-1
    point: np.ndarray  # [N] 0..P-1, every point at least `SHORTEST_TRACK` times
    num_photos: int
    origins: np.ndarray  # [P] what the points were called before
    rows: np.ndarray  # [N] which rows these were before

    def only(self, mask: np.ndarray) -> "Table":
        """The rows of `mask` `[N]` bool, points with too few of them left out."""
        return table(self.values[mask], self.photo[mask], self.point[mask], self.num_photos)


class Fit(NamedTuple):
    """What a robust fit gives."""

    gains: np.ndarray  # [V, 3], mean zero over the photos that have any observation; zero of the others
    residuals: np.ndarray  # [N, 3]
    weights: np.ndarray  # [N] 0..1
    sigma: float  # of the residuals, robust


def table(values: np.ndarray, photo: np.ndarray, point: np.ndarray, num_photos: int) -> Table:
    """A `Table` of the finite rows, of the points that have enough of them."""
    rows = np.flatnonzero(np.isfinite(values).all(-1))
    _, inverse, counts = np.unique(point[rows], return_inverse=True, return_counts=True)
    rows = rows[counts[inverse] >= SHORTEST_TRACK]
    origins, point = np.unique(point[rows], return_inverse=True)
    return Table(values[rows], photo[rows], point, num_photos, origins, rows)


def fit(data: Table) -> Fit:
    """Gains of red, green and blue by iteratively reweighted least squares, drawn to the mean photo's by their noise.

    A photo of few or doubtful observations has the gain of the mean photo rather than one that its tracks do not imply:
    see `_drawn_to_mean`.
    """
    weights = np.ones(len(data.photo))
    residuals, gains, sigma = data.values, np.zeros((data.num_photos, data.values.shape[1])), 0.0
    for _ in range(ROUNDS if len(data.photo) else 0):
        gains, residuals = project(data.values, data, weights)
        size = np.sqrt(np.mean(np.square(residuals), axis=1))
        sigma = 1.4826 * float(np.median(size))
        weights = np.minimum(1.0, OUTLIER * sigma / np.maximum(size, 1e-12))
    has_gain = np.bincount(data.photo, minlength=data.num_photos) > 0
    if has_gain.any():
        gains = _drawn_to_mean(data, weights, gains, residuals)
        gains = np.where(has_gain[:, None], gains - gains[has_gain].mean(0), 0.0)
    return Fit(gains, residuals, weights, sigma)


def _drawn_to_mean(data: Table, weights: np.ndarray, gains: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """`[V, 3]` the most likely gains where those of all photos are spread as these `[V, 3]` are, grey and tints apart.

    A photo's exposure is often far from the mean, its white balance rarely: with the same few observations a tint is
    therefore believed less.
    """
    counts = np.bincount(data.photo, weights, data.num_photos)
    centered = (gains - np.average(gains, axis=0, weights=counts)) @ _GREY_AND_TINTS
    spread2 = np.average(np.square(centered), axis=0, weights=counts)
    noise2 = np.square(1.4826 * np.median(np.abs(residuals @ _GREY_AND_TINTS), axis=0))
    pulls = np.maximum(SHARED * noise2 / np.maximum(spread2, 1e-12), _PULL)
    values = data.values @ _GREY_AND_TINTS
    components = [project(values[:, k : k + 1], data, weights, pull)[0] for k, pull in enumerate(pulls)]
    return np.concatenate(components, axis=1) @ _GREY_AND_TINTS.T


def project(values: np.ndarray, data: Table, weights: np.ndarray, pull: float = _PULL) -> tuple[np.ndarray, np.ndarray]:
    """Photo effects `[V, C]` of weighted least squares of any `[N, C]` values, and what both effects leave `[N, C]`.

    `pull` is the number of observations of effect zero that every photo has in addition to its own.
    """
    shape = (int(data.point.max()) + 1, data.num_photos)
    incidence = sparse.csr_matrix((weights, (data.point, data.photo)), shape)
    per_point = np.maximum(np.asarray(incidence.sum(1)).ravel(), 1e-12)

    def point_sums(columns: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(data.point, weights * column, shape[0]) for column in columns.T], -1)

    photo_sums = np.stack([np.bincount(data.photo, weights * column, shape[1]) for column in values.T], -1)
    shares = sparse.diags(1 / per_point) @ incidence
    system = np.diag(np.asarray(incidence.sum(0)).ravel() + pull) - (incidence.T @ shares).toarray()
    photos = np.linalg.solve(system, photo_sums - shares.T @ point_sums(values))
    left = values - photos[data.photo]
    points = point_sums(left) / per_point[:, None]
    return photos, left - points[data.point]


def held_out_ratio(data: Table, gains: np.ndarray) -> float:
    """How well the other photos of a track predict its colour in one: median error with gains over that without."""

    def error(values: np.ndarray) -> float:
        count = np.bincount(data.point)[data.point][:, None]
        mean = np.stack([np.bincount(data.point, column) for column in values.T], -1)[data.point] / count
        return float(np.median(np.sqrt(np.square((values - mean) * count / (count - 1)).mean(1))))

    return error(data.values - gains[data.photo]) / max(error(data.values), 1e-12)


class Gains(NamedTuple):
    """What tracks imply of the photos' exposure."""

    data: Table  # log2 of linear light
    fit: Fit  # gains in EV, red, green, blue
    noise: float  # EV, of a photo's exposure
    held_out_ratio: float
    agreement: tuple[float, float]  # correlation of both halves of the scene: exposures, white balances


def estimate(observations: Observations) -> Gains | None:
    """Gains of the photos, and how far they can be trusted; None without tracks that say anything."""
    light = np.log2(srgb_to_linear(observations.colors))
    data = table(light, observations.photo, observations.point, len(observations.frames))
    if len(np.unique(data.photo)) < 2:
        return None
    half = np.random.default_rng(0).random(int(data.point.max()) + 1) < 0.5
    first, second = (data.only(side[data.point]) for side in (half, ~half))
    one, other = fit(first), fit(second)
    a, b = _common(one, other, first, second, fewest=1)
    noise = 0.5 * float(np.sqrt(np.mean(np.square((a - b).mean(1))))) if a.size else 0.0
    ratio = held_out_ratio(second, one.gains) if len(second.photo) else 1.0
    return Gains(data, fit(data), noise, ratio, _agreement(observations, data))


def _agreement(observations: Observations, data: Table) -> tuple[float, float]:
    """Correlations of the photos' gains from the two halves of the scene, cut across its longest axis."""
    points = observations.points[data.origins]
    offsets = points - np.median(points, axis=0)
    side = offsets @ np.linalg.svd(offsets, full_matrices=False)[2][0] > 0
    first, second = (data.only(half[data.point]) for half in (side, ~side))
    one, other = _common(fit(first), fit(second), first, second, fewest=_FEWEST)
    luminance = _correlation(one.mean(1), other.mean(1))
    colors = _correlation(*((gains[:, [0, 2]] - gains[:, 1:2]).ravel() for gains in (one, other)))
    return luminance, colors


def _correlation(one: np.ndarray, other: np.ndarray) -> float:
    if one.size < 3 or one.std() == 0 or other.std() == 0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


def _common(one: Fit, other: Fit, first: Table, second: Table, *, fewest: int) -> tuple[np.ndarray, np.ndarray]:
    """Gains `[v, 3]`, mean zero, of the photos that both tables see often enough."""
    counts = [np.bincount(part.photo, minlength=part.num_photos) for part in (first, second)]
    both = np.minimum(*counts) >= fewest
    if not both.any():
        return np.empty((0, 3)), np.empty((0, 3))
    return one.gains[both] - one.gains[both].mean(0), other.gains[both] - other.gains[both].mean(0)
