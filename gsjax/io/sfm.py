"""Bare photos to a COLMAP data set, by pycolmap: SIFT, matching, incremental mapping, undistortion.

Photos are read as they are stored, with no EXIF rotation, by every stage and by `gsjax.io.images` later: a camera
keeps one sensor frame however it was held.
"""

import os
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io.colmap import quiet
from gsjax.io.files import make_folder, unwritable
from gsjax.io.images import image_size, read_image
from gsjax.io.packages import require

pycolmap = require("pycolmap", "pip install pycolmap")

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp")
_EXHAUSTIVE_UP_TO = 150  # photos; beyond, each is matched with its neighbours in name order
_SELF_CALIBRATE_FROM = 20  # registered photos of one camera that pin its principal point down
_POLL_SECONDS = 0.5


@dataclass(frozen=True)
class SfmReport:
    """What a reconstruction came to."""

    images: int  # photos given
    registered: int  # photos with a pose
    points: int
    mean_reprojection_error: float  # pixels of the photos
    mean_track_length: float  # photos a point is seen in
    seconds: float


def reconstruct(
    photos: str | Path,
    out: str | Path,
    *,
    max_image_size: int = 1600,
    threads: int = -1,
    progress: Callable[..., tqdm] = tqdm,
) -> SfmReport:
    """Makes a COLMAP data set (`out/images`, `out/sparse/0`, PINHOLE cameras) from a folder of photos.

    Photos of one size are taken to come from one camera. Up to 150 photos every pair is matched; beyond that each
    photo is matched with those near it in name order, as frames of a video need. The largest model is kept.

    Args:
        photos: Folder of photos, subfolders included.
        out: Folder to make; appears when everything is done. Must not exist, or be empty.
        max_image_size: Features are sought in photos whose longer side is reduced to this, pixels; the photos
            written are not reduced.
        threads: Threads to use, -1 for all cores.
        progress: Makes a progress bar, called with tqdm's `total`, `desc` and `unit`.

    Raises:
        InputError: No folder, fewer than two photos, an unreadable one (named), no model found, or `out` in use or
            not writable.
    """
    start = time.monotonic()
    photos, out = Path(photos), Path(out)
    names = _photo_names(photos)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: exists and is not empty; choose another folder for the scene")
    one_camera = len({image_size(photos / name) for name in names}) == 1
    with _workspace(out) as workspace, quiet(pycolmap):
        pycolmap.set_random_seed(0)
        database = workspace / "database.db"
        _extract(photos, names, database, one_camera, max_image_size, threads, progress)
        _match(len(names), database, threads, progress)
        model = _map(photos, names, database, workspace, threads, progress)
        if one_camera and model.num_reg_images() >= _SELF_CALIBRATE_FROM:
            _self_calibrate(model)
        _undistort(model, photos, workspace, threads, progress)
        _publish(workspace / "dense", out)
    return SfmReport(
        images=len(names),
        registered=model.num_reg_images(),
        points=model.num_points3D(),
        mean_reprojection_error=model.compute_mean_reprojection_error(),
        mean_track_length=model.compute_mean_track_length(),
        seconds=time.monotonic() - start,
    )


def _photo_names(folder: Path) -> list[str]:
    """Names of the photos relative to the folder, sorted, each decoded once to know that it is whole."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of photos")
    files = sorted(f for f in folder.rglob("*") if f.suffix.lower() in PHOTO_SUFFIXES and not f.name.startswith("."))
    if len(files) < 2:
        raise InputError(f"{folder}: needs at least 2 photos ({', '.join(PHOTO_SUFFIXES)}), has {len(files)}")
    for file in files:
        read_image(file)
    return [file.relative_to(folder).as_posix() for file in files]


def _extract(
    photos: Path, names: list[str], database: Path, one_camera: bool, max_image_size: int, threads: int, progress
) -> None:
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "OPENCV" if one_camera else "SIMPLE_RADIAL"
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = max_image_size
    options.num_threads = threads
    options.sift.peak_threshold = 0.004  # below COLMAP's 0.0067: small and blurred photos have few strong corners
    with progress(total=len(names), desc="features", unit="photo") as bar:
        _run_and_watch(
            lambda token: pycolmap.extract_features(
                database,
                photos,
                names,
                pycolmap.CameraMode.SINGLE if one_camera else pycolmap.CameraMode.PER_IMAGE,
                reader,
                options,
                pycolmap.Device.cpu,
                token,
            ),
            lambda: bar.update(_count(database, "SELECT COUNT(*) FROM descriptors") - bar.n),
        )


def _match(count: int, database: Path, threads: int, progress) -> None:
    options = pycolmap.FeatureMatchingOptions()
    options.num_threads = threads
    options.guided_matching = True
    exhaustive = count <= _EXHAUSTIVE_UP_TO
    pairing = pycolmap.ExhaustivePairingOptions() if exhaustive else pycolmap.SequentialPairingOptions()
    matcher = pycolmap.match_exhaustive if exhaustive else pycolmap.match_sequential
    pairs = count * (count - 1) // 2 if exhaustive else None
    verification = pycolmap.TwoViewGeometryOptions()
    with progress(total=pairs, desc="matching", unit="pair") as bar:
        _run_and_watch(
            lambda token: matcher(database, options, pairing, verification, pycolmap.Device.cpu, token),
            lambda: bar.update(_count(database, "SELECT COUNT(*) FROM two_view_geometries") - bar.n),
        )


def _map(photos: Path, names: list[str], database: Path, workspace: Path, threads: int, progress):
    """The model with the most photos."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = threads
    options.random_seed = 0
    options.min_model_size = 2
    folder = make_folder(workspace / "models")
    with progress(total=len(names), desc="mapping", unit="photo") as bar:

        def started() -> None:
            bar.reset()
            bar.update(2)

        models = _run_and_watch(
            lambda token: pycolmap.incremental_mapping(
                database,
                photos,
                folder,
                options,
                initial_image_pair_callback=started,
                next_image_callback=lambda: bar.update(1),
                cancellation_token=token,
            ),
            lambda: None,
        )
    if not models:
        matched = _count(
            database,
            "SELECT COUNT(*) FROM images WHERE EXISTS (SELECT 1 FROM two_view_geometries WHERE rows >= 15 AND"
            " (pair_id / 2147483647 = image_id OR pair_id % 2147483647 = image_id))",
        )
        raise InputError(
            f"{photos}: no model found; {matched} of {len(names)} photos match another one:"
            " take photos that overlap by two thirds, from different places"
        )
    return max(models.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()))


def _self_calibrate(model) -> None:
    """Lets the principal point go as well, which mapping holds at the centre: phones are off by a percent or more."""
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = True
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1  # wrong matches must not bend the camera
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.reg_image_ids():
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    # The shorter `pycolmap.bundle_adjustment` switches COLMAP's log back on.
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    model.update_point_3d_errors()


def _undistort(model, photos: Path, workspace: Path, threads: int, progress) -> None:
    folder = make_folder(workspace / "best")
    model.write_binary(folder)
    written = workspace / "dense" / "images"
    with progress(total=model.num_reg_images(), desc="undistortion", unit="photo") as bar:
        _run_and_watch(
            lambda token: pycolmap.undistort_images(
                workspace / "dense", folder, photos, jpeg_quality=95, num_threads=threads, cancellation_token=token
            ),
            lambda: bar.update(sum(f.is_file() for f in written.rglob("*")) - bar.n),
        )


def _publish(dense: Path, out: Path) -> None:
    """Renames the finished data set onto `out`, in the layout that 3DGS programs read."""
    for path in dense.iterdir():
        if path.name not in ("images", "sparse"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    (dense / "sparse").rename(dense / "0")
    (dense / "sparse").mkdir()
    (dense / "0").rename(dense / "sparse" / "0")
    os.replace(dense, out)


@contextmanager
def _workspace(out: Path) -> Iterator[Path]:
    """A folder beside `out`, gone afterwards whatever happens."""
    make_folder(out.parent)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as folder:
            yield Path(folder)
    except OSError as error:
        raise unwritable(out, error) from error


def _run_and_watch(stage: Callable, watch: Callable[[], None]):
    """Runs a stage of pycolmap in a thread, calling `watch` meanwhile; an interrupt cancels the stage."""
    token = pycolmap.CancellationToken()
    with ThreadPoolExecutor(1) as executor:
        future = executor.submit(stage, token)
        try:
            while wait([future], _POLL_SECONDS).not_done:
                watch()
            watch()
        except BaseException:
            token.cancel()
            raise
        return future.result()


def _count(database: Path, query: str) -> int:
    """One number from COLMAP's database; 0 as long as there is no such table."""
    if not database.is_file():
        return 0
    try:
        with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=5)) as connection:
            return connection.execute(query).fetchone()[0]
    except sqlite3.OperationalError:
        return 0
