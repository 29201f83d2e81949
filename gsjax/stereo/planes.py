"""Planes of a photo's segments: where few planes explain the confident depth in a segment, all of it is on them.

Walls and cupboards have little texture inside, where stereo finds nothing, but their outline has some. On a plane the
inverse depth is affine in the pixel, so that planes are fitted to inverse depth. A map of planes is `[H, W, 3]`:
inverse depth at the pixel's centre, and its slopes per pixel along x and y; the first is 0 where there is no plane.
"""

import numpy as np
from scipy.spatial import KDTree

from gsjax.io.images import cv2
from gsjax.stereo.views import View

WINDOW = 7  # pixels, side of the square in which the slopes of depth are fitted
SEGMENT_SIGMA, SEGMENT_SCALE, SMALLEST_SEGMENT = 0.6, 300.0, 150  # of the graph segmentation, at `SEGMENT_PIXELS`
SEGMENT_PIXELS = 76_800
MOST_PLANES = 3  # of a segment
TOLERANCE = 0.008  # of the inverse depth, up to which a pixel is on a plane
CANDIDATES, SAMPLES = 64, 600  # of a fit: planes that are tried, and pixels that are asked
FEWEST_KNOWN, KNOWN_SHARE = 30, 0.03  # pixels with depth, and their share of a segment, from which planes are fitted
FEWEST_ON, ON_SHARE = 20, 0.1  # pixels on one plane, and their share of those with depth
EXPLAINED = 0.6  # share of the pixels with depth that are on the planes of an accepted segment
THINNEST = 2.0  # pixels, standard deviation across pixels that are no line
REACH = 4.0  # standard deviations of a plane's pixels, as far as it is extended


def local_planes(depth: np.ndarray) -> np.ndarray:
    """Return `[H, W, 3]` the map of planes of depth `[H, W]`: its own value, and slopes fitted around it."""
    height, width = depth.shape
    mask, inverse = (depth > 0).astype(np.float64), inverse_of(depth)
    x, y = np.meshgrid((np.arange(width) - width / 2) / width, (np.arange(height) - height / 2) / width)
    axes = (np.ones_like(x), x, y)
    left = np.stack([np.stack([_summed(mask * a * b) for b in axes], -1) for a in axes], -2) + 1e-9 * np.eye(3)
    slopes = np.linalg.solve(left, np.stack([_summed(inverse * a) for a in axes], -1)[..., None])[..., 1:, 0] / width
    return np.where(depth[..., None] > 0, np.concatenate([inverse[..., None], slopes], axis=-1), 0)


def inverse_of(depth: np.ndarray) -> np.ndarray:
    """Return one over the depth; 0 where that is 0, unknown."""
    return np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)


def _summed(values: np.ndarray) -> np.ndarray:
    return cv2.boxFilter(values, -1, (WINDOW, WINDOW), normalize=False, borderType=cv2.BORDER_CONSTANT)


def segment_planes(view: View, labels: np.ndarray, planes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return `[H, W, 3]` the map of planes of the photo's segments, up to `MOST_PLANES` in each.

    Every pixel of a segment takes the plane of the nearest pixel that is on one, as far as that plane is known. The
    labels `[H, W]` are those of the segments, the planes `[H, W, 3]` those of confident depth.
    """
    result = np.zeros_like(planes)
    labels = labels.ravel()
    order = np.argsort(labels, kind="stable")
    for pixels in np.split(order, np.flatnonzero(np.diff(labels[order])) + 1):
        _explain(pixels, planes, result, (1 / view.farthest, 1 / view.nearest), rng)
    return result


def photo_segments(color: np.ndarray) -> np.ndarray:
    """Return `[H, W]` labels of a graph segmentation (Felzenszwalb and Huttenlocher 2004) of the photo `[H, W, 3]`.

    The photo is uint8; a bilateral filter removes its noise before.
    """
    size = color[..., 0].size / SEGMENT_PIXELS
    smooth = cv2.bilateralFilter(color, 7, 20, 5)
    graph = cv2.ximgproc.segmentation.createGraphSegmentation(
        SEGMENT_SIGMA, SEGMENT_SCALE * size**0.5, int(SMALLEST_SEGMENT * size)
    )
    return graph.processImage(smooth)


def _explain(
    pixels: np.ndarray, planes: np.ndarray, result: np.ndarray, limits: tuple[float, float], rng: np.random.Generator
) -> None:
    """Write the planes of one segment, whose pixels are given by their indices, to the result."""
    width = planes.shape[1]
    inverse = planes[..., 0].ravel()
    samples = pixels[inverse[pixels] > 0]
    if len(samples) < max(FEWEST_KNOWN, KNOWN_SHARE * len(pixels)):
        return
    samples = rng.permutation(samples)[:SAMPLES]
    places = np.stack([samples % width, samples // width], axis=-1) + 0.5
    fits = _fits(places, inverse[samples], rng)
    if sum(len(on) for _, on in fits) < EXPLAINED * len(samples):
        return
    at = np.stack([pixels % width, pixels // width], axis=-1) + 0.5
    owner = np.repeat(np.arange(len(fits)), [len(on) for _, on in fits])
    lying = np.concatenate([places[on] for _, on in fits])
    nearest_fit = owner[KDTree(lying).query(at)[1]] if len(fits) > 1 else np.zeros(len(at), int)
    for index, (plane, on) in enumerate(fits):
        own = nearest_fit == index
        offsets = at[own] - places[on].mean(axis=0)
        near = np.einsum("ni,ij,nj->n", offsets, np.linalg.inv(np.cov(places[on].T)), offsets) < REACH**2
        value = plane[0] + at[own] @ plane[1:]
        is_valid = near & (value > limits[0]) & (value < limits[1])
        slopes = np.broadcast_to(plane[1:], (int(is_valid.sum()), 2))
        result.reshape(-1, 3)[pixels[own][is_valid]] = np.concatenate([value[is_valid, None], slopes], axis=-1)


def _fits(places: np.ndarray, inverse: np.ndarray, rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    """Planes `[3]`, offset and slopes, of `[P, 2]` pixels and their inverse depth; and the indices of those on each."""
    fits, left = [], np.arange(len(places))
    fewest = max(FEWEST_ON, ON_SHARE * len(places))
    for _ in range(MOST_PLANES):
        if len(left) < fewest:
            break
        plane, on = _consensus(places[left], inverse[left], rng)
        if on.sum() < fewest:
            break
        if np.linalg.eigvalsh(np.cov(places[left[on]].T))[0] >= THINNEST**2:
            fits.append((plane, left[on]))
        left = left[~on]
    return fits


def _consensus(places: np.ndarray, inverse: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The plane `[3]` of most of `[P, 2]` pixels among random candidates, fitted to them; `[P]` bool, its pixels."""
    points = np.concatenate([places, inverse[:, None]], axis=-1)
    first, second, third = points[rng.integers(len(points), size=(3, CANDIDATES))]
    normals = np.cross(second - first, third - first)
    steep = np.where(normals[:, 2] != 0, normals[:, 2], 1)  # Three pixels on a line: their slope is taken as 0.
    slopes = np.where(normals[:, 2:] != 0, -normals[:, :2] / steep[:, None], 0)
    offsets = first[:, 2] - np.sum(slopes * first[:, :2], axis=-1)
    misfits = np.abs(places @ slopes.T + offsets - inverse[:, None]) < TOLERANCE * inverse[:, None]
    on = misfits[:, np.argmax(misfits.sum(axis=0))]
    ones = np.concatenate([np.ones((len(places), 1)), places], axis=-1)
    plane = np.zeros(3)
    for _ in range(3):
        if on.sum() < FEWEST_ON:
            break
        plane = np.linalg.lstsq(ones[on], inverse[on], rcond=None)[0]
        on = np.abs(ones @ plane - inverse) < TOLERANCE * inverse
    return plane, on
