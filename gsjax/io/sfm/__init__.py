"""Bare photos, or a video, to a COLMAP data set: features, chosen pairs, incremental mapping, undistortion."""

import errno
import os
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypedDict

from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.child_process import run_in_child
from gsjax.io.files import make_folder, put_in_place, require_empty, unwritable, workspace
from gsjax.io.place_files import write_place

DEFAULT_FRAMES = 100
REPORT = "sfm.json"
_LITTLE_ROOM = 2**24  # bytes: of a full disk that many may be free again, once what did not fit is gone

__all__ = ["DEFAULT_FRAMES", "FILES", "Reconstruction", "SfmReport", "read_report", "reconstruct"]


class Reconstruction(TypedDict, total=False):
    """Options of `reconstruct` that a person chooses, see there."""

    frames: int
    panoramas: bool
    mask_below: float
    features: str
    weights: str | Path
    matcher_weights: str | Path


FILES: Final = ("weights", "matcher_weights")  # options that name one


@dataclass(frozen=True)
class Panoramas:
    """That photos are equirectangular."""

    mask_below: float | None  # degrees below the horizon from which on they are masked; None: nowhere


@dataclass(frozen=True)
class Networks:
    """That features are found, and perhaps matched, by networks in ONNX files."""

    kind: str  # of features, as `gsjax.io.sfm.learned` has them
    weights: Path
    matcher_weights: Path | None


@dataclass(frozen=True)
class SfmReport:
    """What a reconstruction came to."""

    images: int  # photos given, or frames taken of a video
    registered: int  # photos with a pose
    left_out: dict[str, str]  # names of the other photos, and why they have none
    passed_over: dict[str, str]  # names of files that are no photos, and why they are not taken for some
    points: int
    mean_reprojection_error: float  # pixels of the photos
    mean_track_length: float  # photos a point is seen in
    seconds: float
    place: str = ""  # what the photos' GPS told: of metres, up and origin
    gps_unused: dict[str, str] = field(default_factory=dict)  # names of photos, and why their GPS is not followed
    focal_unused: dict[str, str] = field(default_factory=dict)  # names of photos, and why EXIF's is ignored
    second_mapping: str = ""  # which model is kept where mapping ran once more, without focal lengths of EXIF


def reconstruct(
    photos: str | Path,
    out: str | Path,
    *,
    frames: int | None = None,
    panoramas: bool = False,
    mask_below: float | None = None,
    features: str = "sift",
    weights: str | Path | None = None,
    matcher_weights: str | Path | None = None,
    max_image_size: int = 1600,
    threads: int = -1,
    progress: Callable[..., tqdm] = tqdm,
) -> SfmReport:
    """Makes a COLMAP data set (`out/images`, `out/sparse/0`, PINHOLE cameras) from a folder of photos or a video.

    Photos of one make, model, focal length, digital zoom and size are taken to come from one camera, held upright or
    across; what is written is upright, with mattes (alpha) and masks (from a folder `masks/`). EXIF's focal lengths
    from 8 to 400 mm of 35 mm film are where cameras start; where less than half of the photos get a pose so, mapping
    runs once more without them, and the model of more photos is kept. Each photo is matched with the twenty
    most like it, whatever their order, and with the next by name; the largest model is kept. The work is done in a
    process of its own. Where the photos' GPS tells it, the model is in metres, x east, y north, z up, and `place.json`
    says about which origin (`gsjax.scene.georeference`).

    Args:
        photos: Folder of photos, subfolders included; or a video, of which the sharpest frame of every stretch is
            taken.
        out: Folder to make; appears when everything is done. Must not exist, or be empty.
        frames: How many frames to take of a video, None for 100; a shorter video gives all that it has.
        panoramas: The photos, or the video's frames, are equirectangular: 360 degrees across, 180 down. They are
            written whole, with the camera model EQUIRECTANGULAR, which `gsjax.io.scenes` reads as six pinhole faces.
        mask_below: Of panoramas: mask what is so many degrees and more below the horizon, where the operator is.
        features: "sift", or "aliked" or "disk" by OpenCV 5 and the user's own file of `weights`.
        weights: Of ALIKED or DISK, an ONNX file.
        matcher_weights: Of LightGlue for ALIKED, an ONNX file. None: nearest descriptors match.
        max_image_size: SIFT's features are sought in photos whose longer side is reduced to this, pixels; the photos
            written are not reduced.
        threads: Threads to use, -1 for all cores.
        progress: Makes a progress bar, called with tqdm's `total`, `desc` and `unit`.

    Raises:
        InputError: No folder or video, fewer than two photos or frames, fewer than half of them whole, a file of
            weights that is absent or of another network, no model found, `out` in use or not writable, or the process
            of the reconstruction crashed.
    """
    start = time.monotonic()
    photos, out = Path(photos), Path(out)
    if frames is not None and frames < 2:
        raise InputError(f"--frames {frames}: at least 2 are needed")
    if frames is not None and photos.is_dir():
        raise InputError(f"{photos}: is a folder of photos, of which all are taken; --frames is for a video")
    if mask_below is not None and not panoramas:
        raise InputError(f"--mask-below {mask_below:g}: is for panoramas of 360 degrees, add --panoramas")
    if mask_below is not None and not 0 <= mask_below < 90:
        raise InputError(f"--mask-below {mask_below:g}: degrees below the horizon are from 0 to less than 90")
    networks = _networks(features, weights, matcher_weights)
    require_empty(out)
    threads = threads if threads > 0 else len(os.sched_getaffinity(0))
    with workspace(out) as space:
        kind = Panoramas(mask_below) if panoramas else None
        arguments = (photos, space, frames or DEFAULT_FRAMES, kind, networks, max_image_size, threads)
        report = run_in_child(_build, *arguments, name=str(photos), progress=progress)
        report["seconds"] = time.monotonic() - start
        json_files.write(space / "scene" / REPORT, report)  # Of a scene that is there, it can be read again.
        put_in_place(space / "scene", out)
    return SfmReport(**report)


def _networks(features: str, weights: str | Path | None, matcher_weights: str | Path | None) -> Networks | None:
    """What is asked of networks; None: nothing.

    Raises:
        InputError: The options do not go together, or a file is absent.
    """
    if features == "sift":
        if weights is not None or matcher_weights is not None:
            raise InputError("--weights and --matcher-weights go with --features aliked or disk, not with SIFT")
        return None
    if features not in ("aliked", "disk"):
        raise InputError(f"--features {features}: takes sift, aliked or disk")
    if weights is None:
        raise InputError(f"--features {features}: needs --weights FILE.onnx; no weights come with gsjax")
    if matcher_weights is not None and features != "aliked":
        raise InputError(f"--matcher-weights: OpenCV's LightGlue matches features of aliked, not of {features}")
    networks = Networks(features, Path(weights), None if matcher_weights is None else Path(matcher_weights))
    for file in (networks.weights, networks.matcher_weights):
        if file is not None and not file.is_file():
            raise InputError(f"{file}: no such file of weights")
    return networks


def read_report(scene: str | Path) -> SfmReport:
    """What a reconstruction came to, of the data set that it made.

    Raises:
        InputError: The data set holds no report, or a damaged one.
    """
    file = Path(scene) / REPORT
    report = json_files.read(file)
    try:
        return SfmReport(**report)
    except TypeError as error:
        raise InputError(f"{file}: is no report of a reconstruction") from error


def _build(source: Path, workspace: Path, *how: Any) -> dict:
    """The reconstruction (see `_built`) in its own process: leaves `workspace/scene`, returns the report."""
    try:
        return _built(source, workspace, *how)
    except OSError as error:
        raise unwritable(workspace, error) from error
    except RuntimeError as error:  # Also of COLMAP's database, which tells of a full disk in words of its own.
        if shutil.disk_usage(workspace).free > _LITTLE_ROOM:
            raise
        raise unwritable(workspace, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))) from error


def _built(
    source: Path,
    workspace: Path,
    frames: int,
    panoramas: Panoramas | None,
    networks: Networks | None,
    max_image_size: int,
    threads: int,
    progress: Callable[..., tqdm],
) -> dict:
    from gsjax.io.sfm import features, georeference, initial_cameras, learned, mapping, pairs, publishing, shots

    mapping.pycolmap.set_random_seed(0)
    folder = _frames_of(source, workspace / "frames", frames, progress) if source.is_file() else source
    taken, faults = shots.usable_shots(folder)
    if panoramas is not None:
        taken = shots.as_panoramas(taken, panoramas.mask_below)
    hint = shots.panorama_hint(taken) if panoramas is None else ""
    if networks is None:
        found, matcher = features.find_features(taken, max_image_size, threads, progress), None
    else:
        files = networks.weights, networks.matcher_weights
        found, matcher = learned.find_features(taken, networks.kind, *files, threads, progress)
    scores = pairs.likeness(found, threads, progress)
    priors, ignored_focals = initial_cameras.focal_priors(taken)
    material = mapping.Material(taken, found, scores, initial_cameras.guess_cameras(taken, priors), threads, matcher)
    try:
        model, left_out, second_mapping = mapping.map_photos_with_priors(material, priors, workspace, progress)
    except InputError as error:
        raise InputError(f"{source}: {error}{hint}") from error
    placed = georeference.place_model(model, taken)
    publishing.write_dataset(model, taken, make_folder(workspace / "scene"), progress)
    write_place(workspace / "scene", placed.place)
    return {
        "images": len(taken) + len(faults),
        "registered": model.num_reg_images(),
        "left_out": {fault.name: fault.reason for fault in faults}
        | {name: why + hint for name, why in left_out.items()},
        "passed_over": shots.unused_files(folder),
        "points": model.num_points3D(),
        "mean_reprojection_error": model.compute_mean_reprojection_error(),
        "mean_track_length": model.compute_mean_track_length(),
        "place": placed.told,
        "focal_unused": ignored_focals,
        "second_mapping": second_mapping,
        "gps_unused": {shot.name: shot.fix for shot in taken if isinstance(shot.fix, str)}
        | {taken[photo].name: f"{metres:.0f} m from the photo's place" for photo, metres in placed.off.items()},
    }


def _frames_of(source: Path, folder: Path, count: int, progress: Callable[..., tqdm]) -> Path:
    from gsjax.io.images import SUFFIXES
    from gsjax.io.sfm import video

    if source.suffix.lower() in SUFFIXES:
        raise InputError(f"{source}: is one photo; give the folder that holds all of them")
    return video.write_sharpest_frames(source, folder, count, progress)
