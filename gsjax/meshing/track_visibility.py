"""What structure from motion says of a mesh: a photo sees a point that was matched in it, and nothing before it.

The point of a track is on a surface, and the line to it from every photo of it is free. So a mesh shows that lacks a
wall, that has a lump before it or that is next to it. No method of meshing reads tracks; but Gaussians begin at
their points, so a very short run may still have some there. And where there is no texture there are no tracks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gsjax.meshing.ray_queries import ray_caster
from gsjax.meshing.regions import Box
from gsjax.scene import Scene, tracks_by_name
from gsjax.scene.cameras import viewmat_center
from gsjax.scene.meshes import Mesh

LEAST_PHOTOS = 3  # A match of two photos may be wrong and still fit.
LARGEST_ERROR = 3.0  # median reprojection errors, beyond which an observation is not used
SAME_SURFACE = 0.01  # share of the distance from the photo, up to which a mesh is where the point is


@dataclass(frozen=True)
class TrackRays:
    """O straight lines from photos to points that were matched in them, world."""

    origins: np.ndarray  # [O, 3] float64 centres of the photos' cameras
    points: np.ndarray  # [O, 3] float64 where the lines end

    def __len__(self) -> int:
        """How many there are."""
        return len(self.points)

    def within(self, boxes: Sequence[Box]) -> "TrackRays":
        """Those that end in one of the boxes."""
        inside = np.any([box.contains(self.points) for box in boxes], axis=0)
        return TrackRays(self.origins[inside], self.points[inside])


def track_rays(scene: Scene) -> TrackRays:
    """The lines of all tracks of three photos and more; observations that fit their point badly are left out.

    Held-out photos count too: their tracks were matched, but their pixels never trained on.

    Raises:
        InputError: The tracks cannot be read, or name points that the scene does not have.
    """
    by_name, every = tracks_by_name(scene), scene.points.astype(np.float64)
    photos = np.zeros(len(every), int)
    for ids, _ in by_name.values():
        photos += np.bincount(ids, minlength=len(every))
    origins, points, errors = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0)]
    for frame in scene.frames:
        ids, rays = by_name.get(frame.name, (np.zeros(0, int), np.zeros((0, 2))))
        viewmat, focals = frame.viewmat.astype(np.float64), frame.K[[0, 1], [0, 1]]
        local = every[ids] @ viewmat[:3, :3].T + viewmat[:3, 3]
        usable = (local[:, 2] > 0) & (photos[ids] >= LEAST_PHOTOS)
        projections = local[usable, :2] / local[usable, 2:]
        points.append(every[ids[usable]])
        origins.append(np.broadcast_to(viewmat_center(viewmat), points[-1].shape))
        errors.append(np.linalg.norm((projections - rays[usable]) * focals, axis=1))
    off = np.concatenate(errors)
    fits = off <= LARGEST_ERROR * np.median(off) if len(off) else np.zeros(0, bool)
    return TrackRays(np.concatenate(origins)[fits], np.concatenate(points)[fits])


def track_visibility(mesh: Mesh, lines: TrackRays) -> dict[str, float]:
    """What a mesh makes of the sightlines, one at least, by what each of them meets first, whichever side of it.

    Returns:
        Shares that add up to 1: `met` at its point; `nothing`, however long the line is made; something `before` the
        point, in the line; and a surface only `behind` it.
    """
    shares = ray_caster(mesh)(lines.origins, lines.points - lines.origins).distances  # 1: at the point
    nothing, before, behind = ~np.isfinite(shares), shares < 1 - SAME_SURFACE, shares > 1 + SAME_SURFACE
    parts = {"nothing": nothing, "before": before, "behind": behind & ~nothing}
    fractions = {name: float(part.mean()) for name, part in parts.items()}
    return {"met": 1 - sum(fractions.values()), **fractions}
