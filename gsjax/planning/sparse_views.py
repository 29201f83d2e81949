"""Few photos, or photos that stand far apart: training may learn them by heart, and is then held back."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from gsjax.scene import Scene, tracks_by_name
from gsjax.scene.cameras import viewmat_center
from gsjax.settings import Schedule
from gsjax.training.plan import Plan

FAR_APART = 20.0  # degrees
FEW = 15  # photos
FEWEST = 5  # photos that a trial can be made with
SHORTEST = 600  # steps of a run: before a shorter one a trial takes too much of the time, and the angle decides
FEWER = 2  # times, Gaussians: each has more pixels to fit, of more photos
SMOOTH = {"depth_normal": 0.05}  # what is added to every phase: Gaussians lie along the surface that they show
LEFT_OUT = 0.2  # share of the Gaussians that each step leaves out, where no other was asked for
STEREO_SHARE = 9  # One in so many Gaussians begins where photos agree about depth.
POINTS = 2000  # that are looked at
SURE = 2.0  # times its error that a difference must be off zero to count as one

ENTRY = "sparse_views"
"""Of the manifest: a `Decision`."""


class Gain(NamedTuple):
    """What photos that were kept from short trials say of another way to train."""

    decibels: float  # PSNR that way less PSNR as it is, mean over the photos
    error: float  # its standard error over the photos
    depth: float | None = None  # log of how far depth is off that way beside as it is, mean; None: nothing tells
    depth_error: float | None = None  # its standard error over the photos

    @property
    def is_sure(self) -> bool:
        """Whether pictures alone tell which way is better."""
        return abs(self.decibels) > SURE * self.error

    @property
    def is_contradicted(self) -> bool:
        """Whether depth is surely better where pictures are worse, or worse where they are better."""
        return self.decibels * self._sure_depth > 0

    @property
    def helps(self) -> bool:
        """Whether pictures gain; where they are not sure, whether depth is nearer, if that is sure."""
        by_depth = 0.0 if self.is_sure else self._sure_depth
        return by_depth < 0 if by_depth else self.decibels > 0

    @property
    def _sure_depth(self) -> float:
        """`depth`, or 0 where it is not surely another."""
        if self.depth is None or self.depth_error is None:
            return 0.0
        return self.depth if abs(self.depth) > SURE * self.depth_error else 0.0


Trial = Callable[[Callable[[Plan], Plan]], Gain]
"""Regularization of a plan -> its gain in validation runs, see `gsjax.planning.sparse_view_trial.gain`."""


@dataclass(frozen=True)
class Decision:
    """Whether training is held back, and why."""

    photos: int  # that are trained on
    degrees: float | None  # between them; None: no tracks tell
    gain: float | None  # decibels on photos kept from short trials; None: no trial was made, the angle decided
    error: float | None  # of the gain, its standard error
    held_back: bool
    depth: float | None = None  # log of how far depth is off, held back beside as it is; None: nothing tells
    depth_error: float | None = None  # of that, its standard error

    def line(self, plan: Plan) -> str:
        """In words; the plan is that which follows."""
        apart = "" if self.degrees is None else f" {self.degrees:.0f} degrees apart"
        why = "" if self.gain is None else f" (photos kept from short trials: {self._found()})"
        if not self.held_back:
            return f"{self.photos} photos{apart}: holding back would not help{why}"
        left_out = f"each step leaves out {plan.phases[0].dropout:.0%} of them"
        held = f"held back to {plan.max_gaussians:,} Gaussians, {left_out}{why}"
        return f"{self.photos} photos{apart}: {held}; --set schedule.sparse_views=false trains without"

    def _found(self) -> str:
        found = f"{self.gain:+.1f} +-{self.error:.1f} dB"
        return found if self.depth is None else f"{found}, depth there {math.exp(self.depth):.2f} times as far off"


def for_sparse_views(
    planned: Plan,
    scene: Scene,
    schedule: Schedule,
    *,
    trial: Trial | None = None,
    before: Mapping[str, Any] | None = None,
    may_lower: bool = True,
) -> tuple[Plan, Decision | None]:
    """The plan for these photos, and what was decided where they are few or far apart.

    Held back, half of the Gaussians grow, a term draws them along the surface that they show, each step leaves some of
    them out, and some begin where photos agree about depth. Views from between photos gain up to three decibels, or
    lose two (`experiments/results/few_photos.md`), so short trials decide: by pictures where these are sure, else by
    the depth of matched points.

    Args:
        planned: The run.
        scene: Its data set.
        schedule: Whether sparse views are regularized; never in vanilla 3DGS.
        trial: Tells what holding back brings. None: the angle between the photos decides, from `FAR_APART` on.
        before: What was decided when this run began.
        may_lower: Whether fewer Gaussians than planned may be the way: not of a run that goes on.

    Raises:
        InputError: The tracks or photos cannot be read, or the tracks name points that the scene does not have.
    """
    if not schedule.sparse_views or schedule.vanilla:
        return planned, None
    decision = Decision(**before) if before else _decide(planned, scene, trial)
    if decision is None or not decision.held_back:
        return planned, decision
    return held_back(planned, may_lower=may_lower), decision


def is_tried(photos: int, degrees: float | None, steps: int) -> bool:
    """Whether trials decide of so many photos, so far apart, before a run of so many steps."""
    return (photos <= FEW or is_sparse(degrees)) and photos >= FEWEST and steps >= SHORTEST


def _decide(planned: Plan, scene: Scene, trial: Trial | None) -> Decision | None:
    photos, degrees = len(scene.train_frames), angle_between_photos(scene)
    by_angle = is_sparse(degrees)
    if trial is None or not is_tried(photos, degrees, planned.photos_seen):
        return Decision(photos, degrees, None, None, held_back=True) if by_angle else None
    gain = trial(held_back)
    return Decision(photos, degrees, gain.decibels, gain.error, gain.helps, gain.depth, gain.depth_error)


def held_back(planned: Plan, *, may_lower: bool = True) -> Plan:
    """The plan of a run that does not learn its photos by heart; one that is so already stays."""
    most = planned.max_gaussians // FEWER if may_lower else planned.max_gaussians
    smoothed = planned.with_terms(SMOOTH)
    phases = tuple(replace(phase, dropout=phase.dropout or LEFT_OUT) for phase in smoothed.phases)
    stereo_points = max(planned.stereo_points, most // STEREO_SHARE)
    return replace(smoothed, phases=phases, max_gaussians=most, stereo_points=stereo_points)


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
