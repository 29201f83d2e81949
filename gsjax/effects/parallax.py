"""Whether plain regions of photos show something at infinity: a sky turns with the camera, plaster also shifts.

Pairs of photos are compared under one hypothesis after another: their plain regions are at infinity, on the sides of a
box about everything matched, or fixed to the picture. The true one leaves the least difference of light. Exposures and
the fall-off to the corners are fitted to each hypothesis. A region of one even colour supports none of them.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from gsjax.effects.observations import BRIGHTEST, DARKEST, Observations, upwards
from gsjax.effects.photo_gains import Gains
from gsjax.scene.cameras import viewmat_center
from gsjax.scene.colors import srgb_to_linear

VIEWS, PARTNERS, SAMPLES = 32, 8, 200  # photos, spread evenly; others that each is compared with; places of each
OVERLAP = 0.1  # of the places, which a partner shows as well
SIDES, HEIGHTS = (1.0, 1.4, 2.0), (0.05, 0.3, 1.0)  # of boxes: times that of the points; over it, in its size
FAR_SIDES, FAR_HEIGHTS = (3.0, 5.0), (2.0, 4.0)  # of rooms so large that a sky is hardly different from them
TRIMMED = 0.02  # of the points, on each side of the box
FEWEST = 200  # values that a hypothesis is compared by
NOISE = 0.005  # EV, of any photo
OFFSET_PRICE = 0.05  # An exposure that is wrong by 0.1 EV counts as much as differences of 0.02 EV everywhere.

Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(eye `[3]`, unit rays `[R, 3]`) -> distance along each `[R]`."""


class Parallax(NamedTuple):
    """Mean squared differences of light between photos, as multiples of those at infinity."""

    near: float  # of the likeliest box up to about twice as large as what was matched
    far: float  # of the likeliest larger one
    fixed: float  # of what stays where it is in the picture: fall-off, a flash
    difference: float  # root mean square at infinity, EV
    blueness: float  # log2 of green over red in the bluest tenth, 0 is grey
    blue_range: float  # by how much it differs within the regions, EV; light of one colour on plaster has one


class _View(NamedTuple):
    eye: np.ndarray  # [3]
    viewmat: np.ndarray  # [4, 4]
    K: np.ndarray  # [3, 3] of the grid
    light: np.ndarray  # [h, w, 3] EV, NaN outside the region and where a channel is clipped
    places: np.ndarray  # [R, 2] x and y on the grid, within the region
    rays: np.ndarray  # [R, 3] unit, world
    values: np.ndarray  # [R, 3] EV there


def compare(observations: Observations, regions: Mapping[int, np.ndarray], gains: Gains | None) -> Parallax | None:
    """Compare plain regions between photos; None where too few photos show the same, or all of it is clipped.

    `regions` are `[h, w]` bool on the grid of `PhotoFacts.light`, by the index of a frame.
    """
    if not regions or not len(observations.points):
        return None
    stops = np.zeros((len(observations.frames), 3)) if gains is None else gains.fit.gains
    up = upwards(observations.frames)
    up = np.array([0.0, 0.0, 1.0]) if up is None else up
    every = [_view(observations, index, region, stops[index]) for index, region in regions.items()]
    views = [view for view in every if view is not None]
    views = views[:: -(-len(views) // VIEWS) or 1]
    pairs = [(a, b) for a in range(len(views)) for b in _partners(a, views)]
    if not pairs:
        return None
    sizes = ((SIDES, HEIGHTS), (FAR_SIDES, FAR_HEIGHTS))
    near, far = (_boxes(observations, up, *each) for each in sizes)
    ratios, difference = _ratios(views, pairs, (*near, *far))
    if not np.isfinite(ratios).any():
        return None
    of_near, of_far, of_fixed = (_least(each) for each in np.split(ratios, [len(near), len(ratios) - 1]))
    return Parallax(of_near, of_far, of_fixed, difference, *_blue(views))


def _blue(views: Sequence[_View]) -> tuple[float, float]:
    """`Parallax.blueness` and `.blue_range`; zeros where red or green is clipped everywhere, or blue is less."""
    red, green, blue = np.concatenate([view.values for view in views]).T
    values = (green - red)[np.isfinite(green - red) & ~(blue < green)]  # blue is often clipped
    if not len(values):
        return 0.0, 0.0
    lowest, high, highest = np.quantile(values, (0.05, 0.9, 0.95))
    return float(high), float(highest - lowest)


def _least(ratios: np.ndarray) -> float:
    """The least ratio; 0, the most doubtful one, where none could be compared."""
    return float(ratios[np.isfinite(ratios)].min(initial=np.inf)) if np.isfinite(ratios).any() else 0.0


def _view(observations: Observations, index: int, region: np.ndarray, gain: np.ndarray) -> _View | None:
    """The region of one photo without its outline; None where nothing of it is left."""
    frame, light = observations.frames[index], observations.facts[index].light.astype(np.float64)
    inner = np.asarray(ndimage.binary_erosion(region, iterations=2, border_value=1))
    usable = (light > DARKEST) & (light < BRIGHTEST) & (inner & region)[..., None]
    rows, columns = np.nonzero(usable.any(-1))
    if not len(rows) or min(region.shape) < 2:
        return None
    indices = np.unique(np.linspace(0, len(rows) - 1, SAMPLES).astype(int))
    rows, columns = rows[indices], columns[indices]
    viewmat = frame.viewmat.astype(np.float64)
    K = frame.K.astype(np.float64) * np.array([[light.shape[1] / frame.width], [light.shape[0] / frame.height], [1.0]])
    places = np.stack([columns + 0.5, rows + 0.5], -1)
    rays = np.concatenate([(places - K[:2, 2]) / np.diag(K)[:2], np.ones((len(places), 1))], 1) @ viewmat[:3, :3]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    stops = np.where(usable, np.log2(srgb_to_linear(np.where(usable, light, 128.0) / 255)) - gain, np.nan)
    return _View(viewmat_center(viewmat), viewmat, K, stops, places, rays, stops[rows, columns])


def _partners(number: int, views: Sequence[_View]) -> list[int]:
    """Which photos a photo is compared with: those that see the same directions from far next to it."""
    one, scores = views[number], {}
    for index, other in enumerate(views):
        share = np.isfinite(_differences(one, other, _places(other, one.rays))).any(-1).mean()
        if index != number and share > OVERLAP:
            scores[index] = share * np.linalg.norm(one.eye - other.eye)
    return sorted(scores, key=lambda index: -scores[index])[:PARTNERS]


def _places(view: _View, towards: np.ndarray) -> np.ndarray:
    """`[R, 2]` where on its grid a photo shows directions from its eye `[R, 3]`; far outside where it is behind."""
    local = towards @ view.viewmat[:3, :3].T
    in_front = local[:, 2] > 1e-6
    places = local[:, :2] / np.where(in_front, local[:, 2], 1)[:, None] * np.diag(view.K)[:2] + view.K[:2, 2]
    return np.where(in_front[:, None], places, -1e6)


def _differences(one: _View, other: _View, places: np.ndarray) -> np.ndarray:
    """`[R, 3]` light of a photo less that of another at places of its grid, NaN where that has none."""
    height, width = other.light.shape[:2]
    at = np.clip(places - 0.5, -1, (width, height))
    left, top = np.floor(at).astype(int).T
    inside = (left >= 0) & (top >= 0) & (left < width - 1) & (top < height - 1)
    left, top = np.where(inside, left, 0), np.where(inside, top, 0)
    x, y = (at - np.floor(at)).T[..., None]
    upper, lower = ((1 - x) * other.light[row, left] + x * other.light[row, left + 1] for row in (top, top + 1))
    return np.where(inside[:, None], one.values - ((1 - y) * upper + y * lower), np.nan)


def _ratios(
    views: Sequence[_View], pairs: Sequence[tuple[int, int]], surfaces: Sequence[Surface]
) -> tuple[np.ndarray, float]:
    """Of each surface and of the picture's own places, NaN where too little could be compared; and EV at infinity."""
    moments = np.zeros((2, len(surfaces) + 1, len(pairs), 3, 4, 4))  # by each hypothesis, and at infinity
    for row, (a, b) in enumerate(pairs):
        one, other = views[a], views[b]
        at_infinity = _places(other, one.rays)
        whole = _differences(one, other, at_infinity)
        ends = [one.eye + each(one.eye, one.rays)[:, None] * one.rays for each in surfaces]
        for which, places in enumerate((*(_places(other, end - other.eye) for end in ends), one.places)):
            differences = _differences(one, other, places)
            common = np.isfinite(differences) & np.isfinite(whole)
            moments[0, which, row] = _moments(one, other, places, differences, common)
            moments[1, which, row] = _moments(one, other, at_infinity, whole, common)
    left = np.array([[_left_over(each, pairs, len(views)) for each in side] for side in moments])
    counts = moments[0, ..., 0, 0].sum(axis=(1, 2))
    ratios = np.where(counts >= FEWEST, left[0] / left[1], np.nan)
    return ratios, float(np.sqrt(left[1, counts.argmax()]))


def _moments(one: _View, other: _View, places: np.ndarray, differences: np.ndarray, common: np.ndarray) -> np.ndarray:
    """`[3, 4, 4]` sums of products of 1, the difference of the radii squared, to the fourth, and of the light."""
    radii = _radii(one, one.places) - _radii(other, places)
    columns = np.broadcast_to(np.concatenate([np.ones((len(radii), 1)), radii], 1)[:, None], (len(radii), 3, 3))
    values = np.concatenate([columns, differences[..., None]], -1)
    values = np.where(common[..., None], values, 0.0)
    return np.einsum("rci,rcj->cij", values, values)


def _radii(view: _View, places: np.ndarray) -> np.ndarray:
    """`[R, 2]` squared distance from the principal point, 1 at half a diagonal, and its square."""
    height, width = view.light.shape[:2]
    squared = np.square(places - view.K[:2, 2]).sum(-1) * 4 / (height**2 + width**2)
    return np.stack([squared, np.square(squared)], -1)


def _left_over(moments: np.ndarray, pairs: Sequence[tuple[int, int]], num_views: int) -> float:
    """Mean squared difference after the likeliest exposures and fall-off, of `[pairs, 3, 4, 4]` moments."""
    size = 3 * num_views
    system, right = np.zeros((size + 2, size + 2)), np.zeros(size + 2)
    ends = 3 * np.array(pairs)[:, None] * np.ones((1, 3, 1), int) + np.arange(3)[:, None]  # [pairs, 3, 2]
    for side, sign in ((0, 1.0), (1, -1.0)):
        at = ends[..., side]
        np.add.at(system, (at, at), moments[..., 0, 0])
        np.add.at(system, (at, ends[..., 1 - side]), -moments[..., 0, 0])
        np.add.at(right, at, sign * moments[..., 0, 3])
        for column in (1, 2):
            np.add.at(system, (at, np.full(at.shape, size + column - 1)), sign * moments[..., 0, column])
    system[size:, :size] = system[:size, size:].T
    total = moments.sum(axis=(0, 1))
    system[size:, size:], right[size:] = total[1:3, 1:3], total[1:3, 3]
    count = max(total[0, 0], 1.0)
    system[np.diag_indices(size + 2)] += np.r_[np.full(size, OFFSET_PRICE * count / size), np.full(2, 1e-5 * count)]
    solved = np.linalg.solve(system, right)
    return max(total[3, 3] - solved @ right, 0.0) / count + NOISE**2


def _boxes(
    observations: Observations, up: np.ndarray, sides: Sequence[float], heights: Sequence[float]
) -> list[Surface]:
    """Level boxes about the matched points and the cameras, turned to the least area; some lack walls, some a ceiling.

    They are `sides` times as wide as what is within. Ceilings are `heights` over it, and it over floors, in mean half
    widths.
    """
    eyes = np.stack([viewmat_center(frame.viewmat.astype(np.float64)) for frame in observations.frames])
    across = np.linalg.svd(up[None])[2][1:]
    angles = np.radians(np.arange(0, 90, 5))
    turns = [np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) @ across for angle in angles]
    extents = [_extent(observations.points, eyes, np.concatenate([turn, up[None]])) for turn in turns]
    best = int(np.argmin([np.prod((high - low)[:2]) for low, high in extents]))
    axes, (low, high) = np.concatenate([turns[best], up[None]]), extents[best]
    size = max(float((high - low)[:2].mean() / 2), 1e-6)
    middle, half = (low + high) / 2, (high - low) / 2 + 0.02 * size

    def box(side: float, height: float) -> Surface:
        reach = np.append(side * half[:2], half[2] + height * size)

        def distances(eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
            along, start = rays @ axes.T, axes @ eye - middle
            steep = np.maximum(np.abs(along), 1e-9)
            return np.minimum((reach - np.sign(along) * start) / steep, 1e9).min(-1)

        return distances

    every = [(side, height) for side in (*sides, np.inf) for height in (*heights, np.inf)]
    return [box(*each) for each in every[:-1]]


def _extent(points: np.ndarray, eyes: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest coordinates along axes `[3, 3]` of the cameras and most of the points."""
    ends, cameras = np.quantile(points @ axes.T, (TRIMMED, 1 - TRIMMED), axis=0), eyes @ axes.T
    return np.minimum(ends[0], cameras.min(0)), np.maximum(ends[1], cameras.max(0))
