"""Small grey copies of the training photos, their ranges of depth, and the pairs to compare."""

from dataclasses import dataclass

import numpy as np

from gsjax.io.images import cv2, resize
from gsjax.scene import Frame, Scene, tracks_by_name
from gsjax.scene.cameras import Landing, landing, viewmat_centers

SIDE = 320  # pixels, the longer one: depth at every few pixels of a photo is more than a start needs
MOST_VIEWS = 30  # of a data set: as many as a start needs
FEWEST_POINTS = 10  # matched in a photo, that give its range of depth
NEARER, FARTHER = 0.8, 1.5  # times the depths of all but the outermost hundredths of these points
NEIGHBORS = 4
BEST_ANGLE = 8.0  # degrees between two rays to a point: less makes depth uncertain, more makes photos dissimilar
NARROWER, WIDER = 4.0, 15.0  # degrees from the best angle at which a pair is worth 1 / e, on either side
SAMPLED = 4000  # points by which neighbours are chosen


@dataclass(frozen=True)
class View:
    """A photo of the plane sweep."""

    name: str  # the frame's
    color: np.ndarray  # [H, W, 3] uint8
    gray: np.ndarray  # [H, W] float32, 0..1
    usable: np.ndarray  # [H, W] bool: neither masked nor outside of a matte
    K: np.ndarray  # [3, 3] float64 pixels; pixel centres at +0.5
    viewmat: np.ndarray  # [4, 4] float64, world to camera
    nearest: float  # camera z, scene units
    farthest: float  # camera z, scene units
    matched: np.ndarray  # [O] int64, the scene's points that were matched in it

    def landing(self, points: np.ndarray) -> Landing:
        """Project `[P, 3]` world points to pixels."""
        return landing(points, self.viewmat, self.K, self.usable.shape)

    def lift(self, depth: np.ndarray) -> np.ndarray:
        """Return `[P, 3]` world points of the centres of the pixels with depth `[H, W]`, row by row."""
        row, column = np.nonzero(depth)
        pixels = np.stack([column + 0.5, row + 0.5, np.ones(len(row))], axis=-1)
        local = pixels @ np.linalg.inv(self.K).T * depth[row, column, None]
        return (local - self.viewmat[:3, 3]) @ self.viewmat[:3, :3]


def stereo_views(scene: Scene, most: int = MOST_VIEWS) -> tuple[View, ...]:
    """Read the training photos with enough matched points; of more than `most`, some, evenly by name.

    Raises:
        InputError: The tracks cannot be read, or name points that the scene does not have.
    """
    tracks = tracks_by_name(scene)
    with_tracks = [frame for frame in scene.train_frames if frame.name in tracks]
    frames = with_tracks[:: -(-len(with_tracks) // most)] if with_tracks else ()
    views = (_view(frame, scene.points, tracks[frame.name][0]) for frame in frames)
    return tuple(view for view in views if view is not None)


def _view(frame: Frame, points: np.ndarray, matched: np.ndarray) -> View | None:
    depths = points[matched] @ frame.viewmat[2, :3] + frame.viewmat[2, 3]
    depths = depths[depths > 0]
    if len(depths) < FEWEST_POINTS:
        return None
    nearest, farthest = np.percentile(depths, [1, 99])
    shrink = max(frame.width, frame.height) / SIDE
    width, height = frame.width, frame.height
    if shrink > 1:
        width, height = (max(round(side / shrink), 1) for side in (width, height))
    pixels = frame.pixels()
    color = resize(pixels.image, width, height)
    usable = np.ones((height, width), bool)
    for mask in (pixels.matte, pixels.valid):
        if mask is not None:
            usable &= resize(mask, width, height) > 127
    return View(
        frame.name,
        color,
        cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255,
        usable,
        np.diag([width / frame.width, height / frame.height, 1.0]) @ frame.K.astype(np.float64),
        frame.viewmat.astype(np.float64),
        float(NEARER * nearest),
        float(FARTHER * farthest),
        matched,
    )


def neighbors(views: tuple[View, ...], points: np.ndarray) -> list[list[int]]:
    """Return for every view the others to compare it with, best first: those that see its points at the best angle."""
    number = np.concatenate([view.matched for view in views])
    common = np.flatnonzero(np.bincount(number, minlength=len(points)) > 1)
    sampled = common[:: max(len(common) // SAMPLED, 1)]
    sees = np.stack([np.isin(sampled, view.matched) for view in views])
    rays = points[sampled].astype(np.float64) - viewmat_centers(np.stack([view.viewmat for view in views]))[:, None]
    rays /= np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-30)
    best_others = []
    for index in range(len(views)):
        both = sees & sees[index]
        angles = np.degrees(np.arccos(np.clip(np.sum(rays * rays[index], axis=-1), -1, 1)))
        worth = np.exp(-(((angles - BEST_ANGLE) / np.where(angles < BEST_ANGLE, NARROWER, WIDER)) ** 2))
        total = np.where(both, worth, 0).sum(axis=1)
        total[index] = 0
        best = np.argsort(-total, kind="stable")[:NEIGHBORS]
        best_others.append([int(other) for other in best if total[other] > 0])
    return best_others
