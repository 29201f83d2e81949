"""The similarity from a reconstruction to metres on Earth, z up, by the GPS of its photos.

GPS errs by metres, and some fixes by streets. So the fit minimises the median distance (least median of squares), and
the photos near it refine it. GPS heights are the least accurate, and photos along a line leave the rotation about that
line open. Where level cameras determine up more accurately, GPS determines heading, scale and place only.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from gsjax.io.packages import require
from gsjax.io.sfm.gps import Fix
from gsjax.io.sfm.gravity import Up, up_by_gravity
from gsjax.io.sfm.source_photos import SourcePhoto, turned_pose
from gsjax.scene.cameras import viewmat_centers
from gsjax.scene.georeference import Place, turn_upright, up_of_cameras

pycolmap = require("pycolmap")

FEWEST = 3  # photos with GPS, of which one may be wrong only from four on
_HELD_LEVEL = math.radians(1.0)  # systematic error of cameras that are held level
_LARGEST_ERROR = math.radians(10.0)  # of a usable direction up
_LARGEST_NOISE = 0.5  # of the photos' spread: GPS that errs by more determines no scale
_TRIALS = 500
_NEAR = 2.5 * 1.4826  # median distances from the fit, within which a photo's GPS is an inlier
_FLOOR = 1e-3  # of the photos' spread: closer GPS is always an inlier
_SEED = 0


class Georeference(NamedTuple):
    """The place of a model by the GPS of its photos."""

    place: Place  # from the model to the world; unknown where GPS does not determine it
    summary: str  # of the place, in words
    errors: dict[int, float]  # metres between a photo and its GPS, of the outliers, by their index


class _Motion(NamedTuple):
    """A similarity: world = scale * rotation @ model + shift."""

    scale: float
    rotation: np.ndarray
    shift: np.ndarray

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return self.scale * points @ self.rotation.T + self.shift


def georeference(viewmats: np.ndarray, fixes: Sequence[Fix | None], level: Up | None = None) -> Georeference:
    """Fit the place of a model, of `[V, 3, 4]` viewmats of its photos as they are upright, and of their GPS.

    `level` is the direction up. None: as the cameras were held.
    """
    having = np.array([index for index, fix in enumerate(fixes) if fix is not None], int)
    if len(having) < FEWEST:
        having_it = f"GPS in {len(having)} of {len(fixes)} photos" if len(having) else "no GPS in the photos"
        return _unknown(f"unit not known: {having_it}, where {FEWEST} determine metres; `gsjax scale` sets it")
    degrees = np.array([fix for fix in fixes if fix is not None], float)
    centers = viewmat_centers(viewmats)[having]
    level = level or Up(*up_of_cameras(viewmats), "the cameras")
    up, up_error = level.direction, math.hypot(level.error, _HELD_LEVEL)
    has_heights = np.isfinite(degrees[:, 2])
    origin, places = _plane(degrees, has_heights)

    fitted, tilt_error = _fit_with_heights(centers, places, np.flatnonzero(has_heights))
    is_level = fitted is None or up_error < tilt_error
    if is_level:
        flat = np.where(has_heights[:, None], places, places * [1, 1, 0])
        fitted = _least_median(_level(turn_upright(up), has_heights), 2, centers, flat)
    if fitted is None or (is_level and min(up_error, tilt_error) > _LARGEST_ERROR):
        return _unknown("neither the GPS of the photos nor the cameras imply which way is up")
    motion, trusted = fitted
    axes = 2 if is_level else 3
    across = (places[trusted] - places[trusted].mean(0))[:, :axes]
    residual = np.linalg.norm((motion(centers) - places)[:, :axes], axis=1)
    spread = math.sqrt((across**2).sum())
    if math.sqrt((residual[trusted] ** 2).sum()) > _LARGEST_NOISE * spread:
        return _unknown(f"the photos are within {_length(2 * spread / math.sqrt(len(trusted)))} of each other by GPS,"
                        " which is no more than its errors")  # fmt: skip
    errors = {int(having[row]): float(residual[row]) for row in np.setdiff1d(np.arange(len(having)), trusted)}
    altitude = origin[2] if has_heights.any() else None
    known_by = f"GPS of {len(trusted)} photos"
    place = Place(
        known_by,
        up=(0.0, 0.0, 1.0),
        origin=(origin[0], origin[1], altitude),
        scale=motion.scale,
        rotation=tuple(map(tuple, motion.rotation.tolist())),
        shift=tuple(motion.shift.tolist()),
    )
    summary = f"metres by the {known_by}, which are {_length(float(np.median(residual[trusted])))} from it (median)"
    up_source = _up_source(level.source, tilt_error, altitude) if is_level else "the GPS"
    return Georeference(place, f"{summary}; up by {up_source}; origin {_degrees(origin)}", errors)


def _fit_with_heights(
    centers: np.ndarray, places: np.ndarray, rows: np.ndarray
) -> tuple[tuple[_Motion, np.ndarray] | None, float]:
    """Fit the motion of the photos with heights, with its inliers, and the error of its up, radians."""
    fitted = _least_median(_rigid, 3, centers[rows], places[rows]) if len(rows) >= FEWEST else None
    if fitted is None:
        return None, math.inf
    motion, trusted = fitted[0], rows[fitted[1]]
    return (motion, trusted), _tilt_error(motion, centers[trusted], places[trusted])


def place_model(model: Any, photos: Sequence[SourcePhoto]) -> Georeference:
    """Move a model to its place by the GPS of its photos, and return the place that its coordinates have then.

    Without GPS, a model whose photos note gravity is turned upright. It is a `pycolmap.Reconstruction` in the sensors'
    frames, whose image ids count the photos from 1.
    """
    numbers = sorted(model.reg_image_ids())
    registered_photos = [photos[number - 1] for number in numbers]
    poses = [model.image(number).cam_from_world().matrix() for number in numbers]
    viewmats = np.stack(
        [turned_pose(pose, photo.to_upright) for pose, photo in zip(poses, registered_photos, strict=True)]
    )
    level = up_by_gravity(viewmats, [photo.gravity for photo in registered_photos])
    fitted = georeference(
        viewmats, [photo.fix if isinstance(photo.fix, Fix) else None for photo in registered_photos], level
    )
    if level is not None and not fitted.place.is_known:
        upright = Place().turned(turn_upright(level.direction))
        fitted = fitted._replace(place=upright, summary=f"{fitted.summary}; upright by {level.source}")
    place = fitted.place
    if place.moves:
        model.transform(pycolmap.Sim3d(place.scale, pycolmap.Rotation3d(np.array(place.rotation)), place.shift))
    return fitted._replace(
        place=place.reached, errors={numbers[row] - 1: metres for row, metres in fitted.errors.items()}
    )


def _unknown(why: str) -> Georeference:
    return Georeference(Place(), why, {})


def _up_source(by: str, tilt_error: float, altitude: float | None) -> str:
    """Name the source of up, and why it is not GPS."""
    if altitude is None:
        return f"{by} (no altitudes)"
    accuracy = "not at all" if tilt_error > math.pi / 4 else f"to {math.degrees(tilt_error):.1f} degrees"
    return f"{by} (by the GPS {accuracy})"


def _degrees(origin: tuple[float, float, float]) -> str:
    latitude, longitude, _ = origin
    return f"{abs(latitude):.7f} {'NS'[latitude < 0]} {abs(longitude):.7f} {'EW'[longitude < 0]}"


def _length(metres: float) -> str:
    return f"{metres:.2g} m" if metres < 10 else f"{metres:.0f} m"


def _plane(degrees: np.ndarray, has_heights: np.ndarray) -> tuple[tuple[float, float, float], np.ndarray]:
    """Return the origin, at the photos' median, and `[N, 3]` metres east, north and up of it."""
    first = degrees[0, 1]
    longitudes = first + (degrees[:, 1] - first + 180) % 360 - 180  # so that 179 E and 179 W are neighbours
    height = float(np.median(degrees[has_heights, 2])) if has_heights.any() else 0.0
    latitude, longitude = float(np.median(degrees[:, 0])), float(np.median(longitudes))
    heights = np.where(has_heights, degrees[:, 2], height)
    earth = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    places = earth.ellipsoid_to_enu(np.c_[degrees[:, 0], longitudes, heights], latitude, longitude, height)
    return (latitude, (longitude + 180) % 360 - 180, height), np.asarray(places)


Fit = Callable[[np.ndarray, np.ndarray, np.ndarray], _Motion | None]
"""Rows, all positions in the model, all in the world -> the best motion of those rows; None where there is none."""


def _rigid(rows: np.ndarray, model: np.ndarray, world: np.ndarray) -> _Motion | None:
    """Fit the similarity of least squares (Umeyama)."""
    fitted: Any = pycolmap.estimate_sim3d(model[rows], world[rows])
    if fitted is None or not fitted.scale > 0:
        return None
    return _Motion(fitted.scale, fitted.rotation.matrix(), np.asarray(fitted.translation))


def _level(upright: np.ndarray, has_heights: np.ndarray) -> Fit:
    """Return the fit of scale, heading and place, where the rotation that turns up to z is known."""

    def fit(rows: np.ndarray, model: np.ndarray, world: np.ndarray) -> _Motion | None:
        source, target = (each[:, 0] + 1j * each[:, 1] for each in (model[rows] @ upright.T, world[rows]))
        source, target = source - source.mean(), target - target.mean()
        if not np.abs(source).any():
            return None
        turn = (source.conj() @ target) / (source.conj() @ source)
        scale = abs(turn)
        if not scale > 0:
            return None
        c, s = turn.real / scale, turn.imag / scale
        rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ upright
        shift = world[rows].mean(0) - scale * model[rows].mean(0) @ rotation.T
        heights = scale * model @ rotation[2]
        with_height = rows[has_heights[rows]]
        shift[2] = np.median((world[:, 2] - heights)[with_height]) if len(with_height) else -np.median(heights)
        return _Motion(scale, rotation, shift)

    return fit


def _least_median(fit: Fit, minimal: int, model: np.ndarray, world: np.ndarray) -> tuple[_Motion, np.ndarray] | None:
    """Fit the motion of the least median distance, and return its inliers too; None where no sample gives one.

    Distances are horizontal where two photos suffice.
    """
    random, every = np.random.default_rng(_SEED), np.arange(len(model))
    floor = _FLOOR * float(np.median(np.linalg.norm(world - np.median(world, axis=0), axis=1)))

    def distances(motion: _Motion) -> np.ndarray:
        return np.linalg.norm((motion(model) - world)[:, :minimal], axis=1)

    samples = [every] + [random.choice(every, minimal, replace=False) for _ in range(_TRIALS)]
    motions = [motion for rows in samples if (motion := fit(rows, model, world)) is not None]
    if not motions:
        return None
    best = min(motions, key=lambda motion: float(np.median(distances(motion))))
    trusted = every
    for _ in range(3):
        off = distances(best)
        trusted = np.flatnonzero(off <= max(_NEAR * float(np.median(off)), floor))
        again = fit(trusted, model, world)
        if again is None:
            break
        best = again
    return best, trusted


def _tilt_error(motion: _Motion, model: np.ndarray, world: np.ndarray) -> float:
    """Return the standard error of up, radians: the error of GPS over the photos' spread about a line."""
    off = motion(model) - world
    error = math.sqrt((off**2).sum() / max(3 * len(model) - 7, 1))
    widths = np.linalg.svd(motion(model) - motion(model).mean(0), compute_uv=False)
    return math.inf if len(model) < FEWEST or widths[1] < 1e-6 * widths[0] else error / float(widths[1])
