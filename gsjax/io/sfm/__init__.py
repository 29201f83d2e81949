"""Bare photos, or a video, to a COLMAP data set: features, chosen pairs, incremental mapping, undistortion."""

import errno
import os
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypedDict, Unpack

from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.child_process import run_in_child
from gsjax.io.files import put_in_place, require_empty, unwritable, workspace

DEFAULT_FRAMES = 100
REPORT = "sfm.json"
_LITTLE_ROOM = 2**24  # bytes: a full disk may have so many free again, after a failed write


class Reconstruction(TypedDict, total=False):
    """Options of `reconstruct` that a person chooses.

    Panoramas are equirectangular, 360 degrees across and 180 down. They are written whole, with the camera model
    EQUIRECTANGULAR, which `gsjax.io.scenes` reads as six pinhole faces.
    """

    frames: int  # to take of a video, 100 where it is absent; a shorter video gives all that it has
    panoramas: bool  # whether the photos, or the video's frames, are some
    mask_below: float  # of panoramas: mask what is so many degrees and more below the horizon, where the operator is
    features: str  # "sift", or "aliked" or "disk" by OpenCV 5 and the user's own file of `weights`
    weights: str | Path  # of ALIKED or DISK, an ONNX file
    matcher_weights: str | Path  # of LightGlue for ALIKED, an ONNX file; absent: nearest descriptors match


FILES: Final = ("weights", "matcher_weights")  # options that name one


@dataclass(frozen=True)
class Options:
    """The options of `reconstruct`, checked."""

    frames: int = DEFAULT_FRAMES
    panoramas: bool = False
    mask_below: float | None = None
    features: str = "sift"
    weights: str | Path | None = None
    matcher_weights: str | Path | None = None

    def __post_init__(self):
        if self.frames < 2:
            raise InputError(f"frames={self.frames}: at least 2 are needed")
        if self.mask_below is not None and not self.panoramas:
            raise InputError(f"mask_below={self.mask_below:g}: is for panoramas of 360 degrees")
        if self.mask_below is not None and not 0 <= self.mask_below < 90:
            raise InputError(f"mask_below={self.mask_below:g}: degrees below the horizon are from 0 to less than 90")
        files = [Path(file) for file in (self.weights, self.matcher_weights) if file is not None]
        if self.features == "sift" and files:
            raise InputError("weights and matcher_weights go with features=aliked or disk, not with SIFT")
        if self.features not in ("sift", "aliked", "disk"):
            raise InputError(f"features={self.features}: takes sift, aliked or disk")
        if self.features != "sift" and self.weights is None:
            raise InputError(f"features={self.features}: needs the file of its weights; no weights come with gsjax")
        if self.features == "disk" and self.matcher_weights is not None:
            raise InputError("matcher_weights: OpenCV's LightGlue matches features of aliked, not of disk")
        for file in files:
            if not file.is_file():
                raise InputError(f"{file}: no such file of weights")


@dataclass(frozen=True)
class SfmReport:
    """The result of a reconstruction."""

    images: int  # photos given, or frames taken of a video
    registered: int  # photos with a pose
    left_out: dict[str, str]  # names of the other photos, and the reasons
    passed_over: dict[str, str]  # names of files that are no photos, and the reasons
    points: int
    mean_reprojection_error: float  # pixels of the photos
    mean_track_length: float  # photos a point is seen in
    seconds: float
    place: str = ""  # metres, up and origin by the photos' GPS, in words
    gps_unused: dict[str, str] = field(default_factory=dict)  # names of photos, and why their GPS is not used
    focal_unused: dict[str, str] = field(default_factory=dict)  # names of photos, and why EXIF's is ignored
    second_mapping: str = ""  # which model is kept where mapping ran once more, without focal lengths of EXIF


def reconstruct(
    photos: str | Path,
    out: str | Path,
    *,
    progress: Callable[..., tqdm] = tqdm,
    **options: Unpack[Reconstruction],
) -> SfmReport:
    """Make a COLMAP data set (`out/images`, `out/sparse/0`, PINHOLE cameras) from a folder of photos or a video.

    Photos of one make, model, focal length, digital zoom and size are assumed to come from one camera, held upright or
    across; the result is upright, with mattes (alpha) and masks (from a folder `masks/`). EXIF's focal lengths
    from 8 to 400 mm of 35 mm film are where cameras start; where less than half of the photos get a pose so, mapping
    runs once more without them, and the model of more photos is kept. Each photo is matched with the twenty
    most like it, whatever their order, and with the next by name; the largest model is kept. The work is done in a
    process of its own. Where the photos' GPS determines it, the model is in metres, x east, y north, z up, and
    `place.json` says about which origin (`gsjax.scene.georeference`).

    Args:
        photos: Folder of photos, subfolders included; or a video, of which the sharpest frame of every stretch is
            taken.
        out: Folder to make; appears when everything is done. Must not exist, or be empty.
        progress: Makes a progress bar, called with tqdm's `total`, `desc` and `unit`.
        options: See `Reconstruction`.

    Raises:
        InputError: No folder or video, fewer than two photos or frames, fewer than half of them whole, a file of
            weights that is absent or of another network, no model found, `out` in use or not writable, or the process
            of the reconstruction crashed.
    """
    start = time.monotonic()
    photos, out = Path(photos), Path(out)
    if "frames" in options and photos.is_dir():
        raise InputError(f"{photos}: is a folder of photos, of which all are taken; frames is for a video")
    checked = Options(**options)
    require_empty(out)
    with workspace(out) as space:
        report = run_in_child(_build, photos, space, checked, name=str(photos), progress=progress)
        report["seconds"] = time.monotonic() - start
        json_files.write(space / "scene" / REPORT, report)  # Of a scene that is there, it can be read again.
        put_in_place(space / "scene", out)
    return SfmReport(**report)


def read_report(scene: str | Path) -> SfmReport:
    """Read the report of a reconstruction from its data set.

    Raises:
        InputError: The data set holds no report, or a damaged one.
    """
    file = Path(scene) / REPORT
    report = json_files.read(file)
    try:
        return SfmReport(**report)
    except TypeError as error:
        raise InputError(f"{file}: is no report of a reconstruction") from error


def _build(source: Path, workspace: Path, options: Options, progress: Callable[..., tqdm]) -> dict:
    """Reconstruct in its own process: leave `workspace/scene`, return the report."""
    from gsjax.io.sfm.reconstruction import build  # Loads pycolmap and OpenCV, which the parent needs not.

    try:
        return build(source, workspace, options, progress)
    except OSError as error:
        raise unwritable(workspace, error) from error
    except RuntimeError as error:  # Also of COLMAP's database, which reports a full disk in words of its own.
        if shutil.disk_usage(workspace).free > _LITTLE_ROOM:
            raise
        raise unwritable(workspace, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))) from error
