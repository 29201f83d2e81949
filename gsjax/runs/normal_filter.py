"""The consistency filter of normal maps: a normal loses weight where photos of the same place disagree.

In a run the depth is what the Gaussians show when the surface phase begins; before any run it is that of the tracks.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from gsjax.gaussians import Gaussians
from gsjax.io import json_files
from gsjax.io.arrays import read_arrays
from gsjax.io.files import atomic_path
from gsjax.io.messages import first_names
from gsjax.io.normal_maps import normal_maps
from gsjax.normals.consistency import PhotoEvidence, Verdict, View, full_size, judge_maps, stride_of, thinned_view
from gsjax.normals.fitted_depth import sparse_depth
from gsjax.rendering import DepthReading, gallery
from gsjax.runs.records import NUMBER
from gsjax.runs.result import BACKGROUND_COLORS, frame_camera
from gsjax.scene import Frame, Keep, Scene, in_memory, tracks_by_name
from gsjax.scene.cameras import thinned_K

CONFIDENCE, VERDICT = "confidence.npz", "gate.json"  # in the run's folder of maps


def filter_normals(
    folder: Path,
    gaussians: Gaussians,
    frames: Sequence[Frame],
    maps: Sequence[np.ndarray],
    depth_mode: DepthReading,
    *,
    keep: Keep = in_memory,
    notify: Callable[[str], None],
) -> list[np.ndarray]:
    """Scale the maps of a run by the confidence of each normal: lengths from 0 to 127.

    Confidences are computed once and stored in `folder`, so that a resumed run has the same numbers.

    Args:
        folder: Exists; gets `confidence.npz` and `gate.json`.
        gaussians: As the surface phase begins.
        frames: The photos.
        maps: `[H, W, 3]` int8 a photo, 127 times the unit normal.
        depth_mode: See `gsjax.rendering`.
        keep: Where the maps that are returned are to be.
        notify: Receives the verdict as one line.
    """
    file = folder / CONFIDENCE
    if not file.is_file():
        cameras = [frame_camera(frame) for frame in frames]
        pictures = gallery.pictures(gaussians, cameras, BACKGROUND_COLORS["black"], depth_mode)
        triples = zip(maps, pictures, frames, strict=True)
        views = [thinned_view(normals, picture.depth, frame.viewmat, frame.K) for normals, picture, frame in triples]
        evidence, verdict = _evidence(views, frames)
        json_files.write(folder / VERDICT, record(evidence, verdict, frames))
        with atomic_path(file) as temporary:
            confidences = {str(index): np.rint(255 * one.confidence) for index, one in enumerate(evidence)}
            np.savez_compressed(temporary, **{name: each.astype(np.uint8) for name, each in confidences.items()})
        notify(verdict_line(verdict))
    confidences = read_arrays(file)
    pairs = ((normals, confidences[str(index)]) for index, normals in enumerate(maps))
    return [
        keep(np.rint(m * (full_size(c, m.shape[:2])[..., None] / np.float32(255))).astype(np.int8)) for m, c in pairs
    ]


def stored_disagreements(folder: Path, frames: Sequence[Frame]) -> list[float | None]:
    """Read how many degrees each photo's normals are from its neighbours', as `filter_normals` stored it.

    None where it could not judge, or where the file is of an earlier version; InputError where a photo is missing.
    """
    shape = {"photos": {frame.name: {"apart?": NUMBER} for frame in frames}}
    photos = json_files.read(folder / VERDICT, shape)["photos"]
    return [photos[frame.name].get("apart") for frame in frames]


def score_folder(folder: str | Path, scene: Scene) -> dict[str, Any]:
    """Judge a folder of maps by the depth of planes through the tracks' points, and return the `record`."""
    tracks, readers = tracks_by_name(scene), normal_maps(folder, scene.frames)
    views = [
        _tracked_view(frame, readers[frame.name](), scene.points, tracks.get(frame.name))
        for frame in tqdm(scene.frames, desc=Path(folder).name, unit="map", leave=False)
    ]
    evidence, verdict = _evidence(views, scene.frames)
    return record(evidence, verdict, scene.frames)


def record(evidence: Sequence[PhotoEvidence], verdict: Verdict, frames: Sequence[Frame]) -> dict[str, Any]:
    """Return plain values for a file: the verdict on all maps, and the figures of each photo."""
    return {
        "kept": verdict.is_accepted,
        **{name: getattr(verdict, name) for name in ("evidence", "noise", "threshold", "share", "note")},
        "photos": {
            frame.name: {
                "kept": photo.mean_confidence,
                **{name: getattr(photo, name) for name in ("evidence", "noise", "apart")},
                "rejected": not photo.mean_confidence,
            }
            for frame, photo in zip(frames, evidence, strict=True)
        },
    }


def verdict_line(verdict: Verdict) -> str:
    """Return the verdict as one line."""
    decision = (
        f"{100 * verdict.share:.0f} % of the normals have weight" if verdict.is_accepted else "no normal has weight"
    )
    if verdict.evidence is None:
        return f"{decision}: {verdict.note}"
    return (
        f"{decision}: consistency {verdict.evidence:.2f} +-{verdict.noise:.2f} (1 is perfect, 0 as maps that face"
        f" their cameras, needed {verdict.threshold:g}), {verdict.note}"
    )


def _evidence(views: Sequence[View], frames: Sequence[Frame]) -> tuple[list[PhotoEvidence], Verdict]:
    """The evidence of each photo, and the verdict; its note names the first rejected photos."""
    evidence, verdict = judge_maps(
        views, progress=lambda numbers: tqdm(numbers, desc="filter of normals", unit="photo", leave=False)
    )
    if verdict.rejected:
        names = first_names([frames[index].name for index in verdict.rejected])
        verdict = verdict._replace(note=f"{verdict.note}: {names}")
    return evidence, verdict


def _tracked_view(
    frame: Frame, normals: np.ndarray, points: np.ndarray, tracked: tuple[np.ndarray, np.ndarray] | None
) -> View:
    view = thinned_view(normals, np.zeros(normals.shape[:2]), frame.viewmat, frame.K)
    if tracked is None:
        return view
    indices, rays = tracked
    depths = points[indices] @ frame.viewmat[2, :3] + frame.viewmat[2, 3]
    ahead = depths > 0
    K = thinned_K(frame.K, stride_of(normals.shape))
    return view._replace(depth=sparse_depth(rays[ahead], depths[ahead], K, view.depth.shape))
