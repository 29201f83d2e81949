"""Sparse-view regularization: training on few photos, or photos far apart, may overfit, and is then regularized."""

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
APART, SOME = 10.0, 30  # degrees from which, and photos up to which dropout alone helps
FEWEST = 5  # photos of a validation run
SHORTEST = 600  # steps of a run: for a shorter one validation takes too much time, and the angle decides
LONG = 3000  # steps of a run that overfits them; dropout blurs shorter ones
FEWER = 2  # times, Gaussians: each has more pixels to fit, of more photos
SMOOTH = {"depth_normal": 0.05}  # what is added to every phase: Gaussians are along the surface that they show
LEFT_OUT = 0.2  # share of the Gaussians that each step leaves out, unless the settings name another
LEFT_OUT_ALONE = 0.3  # the same, where nothing else changes
STEREO_SHARE = 9  # One in so many Gaussians starts from multi-view stereo.
POINTS = 2000  # whose angles are measured
SURE = 2.0  # standard errors that a significant difference is away from zero

ENTRY = "sparse_views"
"""Of the manifest: a `Decision`."""


class Gain(NamedTuple):
    """The gain of another way to train, on photos that validation runs hold out."""

    decibels: float  # PSNR with the change less without, mean over the photos
    error: float  # its standard error over the photos
    depth: float | None = None  # log of the ratio of depth errors, with the change over without, mean; None: unknown
    depth_error: float | None = None  # its standard error over the photos

    @property
    def is_sure(self) -> bool:
        """Whether the difference of PSNR is significant."""
        return abs(self.decibels) > SURE * self.error

    @property
    def is_contradicted(self) -> bool:
        """Whether depth changes significantly in the direction opposite to PSNR."""
        return self.decibels * self._sure_depth > 0

    @property
    def helps(self) -> bool:
        """Whether PSNR gains; where that is not significant, whether depth does, if significantly."""
        by_depth = 0.0 if self.is_sure else self._sure_depth
        return by_depth < 0 if by_depth else self.decibels > 0

    @property
    def _sure_depth(self) -> float:
        """`depth`, or 0 where it is not significant."""
        if self.depth is None or self.depth_error is None:
            return 0.0
        return self.depth if abs(self.depth) > SURE * self.depth_error else 0.0


Validate = Callable[[Callable[[Plan], Plan]], Gain]
"""Regularization of a plan -> its gain in validation runs, see `gsjax.planning.sparse_view_validation.gain`."""


@dataclass(frozen=True)
class Decision:
    """Whether training is regularized, and why. The fields are keys of the manifest."""

    photos: int  # that are trained on
    degrees: float | None  # between them; None: unknown without tracks
    gain: float | None  # decibels in validation runs; None: there was none, the angle decided
    error: float | None  # of the gain, its standard error
    held_back: bool
    depth: float | None = None  # log of the ratio of depth errors, regularized over not; None: unknown
    depth_error: float | None = None  # of that, its standard error
    dropout_alone: bool = False  # whether each step leaves Gaussians out, and nothing else changes

    def line(self, plan: Plan) -> str:
        """The line for the user, with the plan that follows."""
        apart = "" if self.degrees is None else f" {self.degrees:.0f} degrees apart"
        why = "" if self.gain is None else f" (validation runs: {self.gain:+.1f} +-{self.error:.1f} dB"
        why += "" if self.depth is None else f", {math.exp(self.depth):.2f} times the error of depth"
        why += ")" if why else ""
        share, without = f"{plan.phases[0].dropout:.0%}", "schedule.sparse_views=false trains without"
        if self.dropout_alone:
            return f"{self.photos} photos{apart}: each step leaves out {share} of the Gaussians; {without}"
        if not self.held_back:
            return f"{self.photos} photos{apart}: no sparse-view regularization{why}"
        regularized = f"{plan.max_gaussians:,} Gaussians, of which each step leaves out {share}"
        return f"{self.photos} photos{apart}: sparse-view regularization with {regularized}{why}; {without}"


def for_sparse_views(
    planned: Plan,
    scene: Scene,
    schedule: Schedule,
    *,
    validate: Validate | None = None,
    before: Mapping[str, Any] | None = None,
    may_lower: bool = True,
) -> tuple[Plan, Decision | None]:
    """The plan for these photos, and the decision where they are few or far apart.

    Regularized, a run has half of the Gaussians, and some of them start from multi-view stereo. A term aligns them with
    the surface, and each step leaves some of them out. Views between the photos gain up to three decibels, or lose two
    (`experiments/results/few_photos.md`). So validation runs decide: by PSNR where its difference is significant, else
    by the depth of matched points. With more photos, which are less far apart, a long run leaves Gaussians out and
    changes nothing else; validation runs are too short to overfit these.

    Vanilla 3DGS is never regularized. Without `validate` the angle between the photos decides, from `FAR_APART` on.
    `before` is the decision that was made when this run began. A run that resumes keeps its number of Gaussians: no
    `may_lower`.

    Raises:
        InputError: The tracks or photos cannot be read, or the tracks name points that the scene does not have.
    """
    if not schedule.sparse_views or schedule.vanilla:
        return planned, None
    decision = Decision(**before) if before else _decide(planned, scene, validate)
    if decision is not None and decision.held_back:
        planned = regularize(planned, may_lower=may_lower)
    elif decision is not None and decision.dropout_alone:
        planned = _with_dropout(planned, LEFT_OUT_ALONE)
    return planned, decision


def is_tried(photos: int, degrees: float | None, steps: int) -> bool:
    """Whether validation runs decide for so many photos, so far apart, and a run of so many steps."""
    return (photos <= FEW or is_sparse(degrees)) and photos >= FEWEST and steps >= SHORTEST


def _decide(planned: Plan, scene: Scene, validate: Validate | None) -> Decision | None:
    photos, degrees = len(scene.train_frames), angle_between_photos(scene)
    if validate is None or not is_tried(photos, degrees, planned.photos_seen):
        held_back, alone = is_sparse(degrees), needs_dropout(photos, degrees, planned.photos_seen)
        decision = Decision(photos, degrees, None, None, held_back, dropout_alone=alone and not held_back)
        return decision if held_back or alone else None
    gain = validate(regularize)
    return Decision(photos, degrees, gain.decibels, gain.error, gain.helps, gain.depth, gain.depth_error)


def regularize(planned: Plan, *, may_lower: bool = True) -> Plan:
    """The plan of a run that overfits less; a plan that is regularized already stays as it is."""
    most = planned.max_gaussians // FEWER if may_lower else planned.max_gaussians
    stereo_points = max(planned.stereo_points, most // STEREO_SHARE)
    smoothed = replace(planned.with_terms(SMOOTH), max_gaussians=most, stereo_points=stereo_points)
    return _with_dropout(smoothed, LEFT_OUT)


def _with_dropout(planned: Plan, share: float) -> Plan:
    """The plan whose phases leave out their own share of the Gaussians, or else this one."""
    return replace(planned, phases=tuple(replace(phase, dropout=phase.dropout or share) for phase in planned.phases))


def needs_dropout(photos: int, degrees: float | None, steps: int) -> bool:
    """Whether a run of so many steps overfits photos that are neither few nor far apart."""
    return photos <= SOME and degrees is not None and degrees >= APART and steps >= LONG


def is_sparse(angle: float | None) -> bool:
    """Whether photos at this angle are far apart; at an unknown angle they are not."""
    return angle is not None and angle >= FAR_APART


def angle_between_photos(scene: Scene) -> float | None:
    """Degrees between the directions from which a training photo and the nearest other one see a point.

    Of every point the median over the training photos that it was matched in, then the median over points; None where
    no point was matched in two of them.

    Raises:
        InputError: The tracks cannot be read, or name points that the scene does not have.
    """
    by_name = tracks_by_name(scene)
    views = [(frame, by_name[frame.name][0]) for frame in scene.train_frames if frame.name in by_name]
    if not views:
        return None
    photo = np.repeat(np.arange(len(views)), [len(ids) for _, ids in views])
    point = np.concatenate([ids for _, ids in views])
    matched = np.flatnonzero(np.bincount(point) > 1)
    sample = matched[:: max(len(matched) // POINTS, 1)]
    in_sample = np.isin(point, sample)
    photo, point = photo[in_sample], point[in_sample]
    centers = np.stack([viewmat_center(frame.viewmat) for frame, _ in views]).astype(np.float64)
    angles = [_to_the_nearest(centers[photo[point == each]] - scene.points[each]) for each in sample]
    return float(np.median(angles)) if angles else None


def _to_the_nearest(rays: np.ndarray) -> float:
    """Median over `[K, 3]` rays of the angle to the nearest other one, degrees."""
    unit = rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-30)
    cosines = np.clip(unit @ unit.T, -1, 1)
    np.fill_diagonal(cosines, -1)
    return float(np.degrees(np.median(np.arccos(cosines.max(axis=1)))))
