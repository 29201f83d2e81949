"""Photos that stand far apart: where few of them see a point, and from all sides, training learns them by heart."""

from dataclasses import replace

import numpy as np

from gsjax.cameras import viewmat_center
from gsjax.scene import Scene, tracks_by_name
from gsjax.settings import Settings
from gsjax.training.plan import Plan

FAR_APART = 20.0  # degrees
FEWER = 2  # times, Gaussians: each has more pixels to fit, of more photos
SMOOTH = {"depth_normal": 0.05}  # what is added to every phase: Gaussians lie along the surface that they show
LEFT_OUT = 0.2  # share of the Gaussians that each step leaves out, where no other was asked for
STEREO_SHARE = 9  # One in so many Gaussians begins where photos agree about depth.
POINTS = 2000  # that are looked at


def for_sparse_views(
    planned: Plan, scene: Scene, settings: Settings, *, may_lower: bool = True
) -> tuple[Plan, tuple[str, ...]]:
    """The plan for these photos, and lines that say what is held back, if anything is.

    Where photos stand far apart, half of the Gaussians grow, a term draws them along the surface that they show, each
    step leaves some of them out, and some begin where photos agree about depth: views from between photos gain two
    decibels (`experiments/results/few_photos.md`). Photos side by side are not learned by heart, however few they are,
    and would lose.

    Args:
        planned: The run.
        scene: Its data set; without tracks nothing is held back.
        settings: Whether it is to be looked at (`sparse_views`); never of plain 3DGS.
        may_lower: Whether fewer Gaussians than planned may be the way: not of a run that goes on.

    Raises:
        InputError: The tracks cannot be read, or name points that the scene does not have.
    """
    asked = settings.sparse_views and not settings.vanilla
    angle = angle_between_photos(scene) if asked else None
    if angle is None or not is_sparse(angle):
        return planned, ()
    most = planned.max_gaussians // FEWER if may_lower else planned.max_gaussians
    smoothed = planned.with_terms(SMOOTH)
    stereo_points = max(planned.stereo_points, most // STEREO_SHARE)
    phases = tuple(replace(phase, dropout=phase.dropout or LEFT_OUT) for phase in smoothed.phases)
    fewer = f" instead of max_gaussians={planned.max_gaussians:,} (--set sparse_views=false)" if may_lower else ""
    line = f"photos stand {angle:.0f} degrees apart, seen from what they show: at most {most:,} Gaussians{fewer}"
    left_out = f"each step leaves out {phases[0].dropout:.0%} of them"
    return replace(smoothed, phases=phases, max_gaussians=most, stereo_points=stereo_points), (f"{line}; {left_out}",)


def is_sparse(angle: float | None) -> bool:
    """Whether photos at this angle stand far apart; unknown, they do not."""
    return angle is not None and angle >= FAR_APART


def angle_between_photos(scene: Scene) -> float | None:
    """Degrees between the directions from which a training photo and the nearest other one see a point.

    Of every point the median over the training photos that it was matched in, then the median over points; None where
    no point was matched in two of them.

    Args:
        scene: A loaded data set.

    Raises:
        InputError: The tracks cannot be read, or name points that the scene does not have.
    """
    by_name = tracks_by_name(scene)
    seen = [(frame, by_name[frame.name][0]) for frame in scene.train_frames if frame.name in by_name]
    if not seen:
        return None
    photo = np.repeat(np.arange(len(seen)), [len(ids) for _, ids in seen])
    point = np.concatenate([ids for _, ids in seen])
    matched = np.flatnonzero(np.bincount(point) > 1)
    chosen = matched[:: max(len(matched) // POINTS, 1)]
    kept = np.isin(point, chosen)
    photo, point = photo[kept], point[kept]
    centers = np.stack([viewmat_center(frame.viewmat) for frame, _ in seen]).astype(np.float64)
    angles = [_to_the_nearest(centers[photo[point == each]] - scene.points[each]) for each in chosen]
    return float(np.median(angles)) if angles else None


def _to_the_nearest(rays: np.ndarray) -> float:
    """Median over `[K, 3]` rays of the angle to the nearest other one, degrees."""
    unit = rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-30)
    cosines = np.clip(unit @ unit.T, -1, 1)
    np.fill_diagonal(cosines, -1)
    return float(np.degrees(np.median(np.arccos(cosines.max(axis=1)))))
