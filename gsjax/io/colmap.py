"""COLMAP models, binary and text, read by pycolmap once the files are known to be whole.

pycolmap 4.2 reads past the end of a truncated file: some cuts give an allocation of a random size, some a model with
cameras of zeros. So the record lengths are walked first.
"""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.image_folders import found_files
from gsjax.io.lenses import Lens, check_lens, is_float32
from gsjax.io.packages import require
from gsjax.io.photos import Capture, Photo
from gsjax.scene import Tracks

MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0", ".")
PARTS = ("cameras", "images", "points3D")


def find_model(root: Path) -> Path | None:
    """The folder under `root` that holds a COLMAP model's cameras file, or None."""
    for folder in MODEL_FOLDERS:
        if any((root / folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return root / folder
    return None


def read_capture(root: Path, model: Path) -> Capture:
    """Photos and points of a COLMAP model; images without a pose are left out.

    Args:
        root: The data set; photos lie in `images/` in it or beside the model, or in it directly.
        model: Folder of the model (`find_model`).

    Raises:
        InputError: A file is missing, truncated or contradicts another; a camera model is unknown; no points.
    """
    reconstruction = _read_model(model)
    if not reconstruction.points3D:
        raise InputError(f"{model}: the COLMAP model has no points")
    ordered = [reconstruction.points3D[i] for i in sorted(reconstruction.point3D_ids())]
    points = np.array([p.xyz for p in ordered])
    colors = np.array([p.color for p in ordered], np.uint8)
    broken = ~is_float32(points).all(axis=1)
    if broken.any():
        raise InputError(f"{model}: {broken.sum()} of {len(points)} points of the COLMAP model are not finite")
    photos = _photos(reconstruction, root, model)
    return Capture("colmap", photos, points.astype(np.float32), colors, partial(read_tracks, model))


def read_tracks(model: Path) -> Tracks:
    """The observations of a COLMAP model, photos sorted by name, points in the order of `read_capture`.

    Keypoints whose lens model gives no ray are left out.

    Raises:
        InputError: As `read_capture`.
    """
    reconstruction = _read_model(model)
    rows = {point: row for row, point in enumerate(sorted(reconstruction.point3D_ids()))}
    photos = sorted((image for image in reconstruction.images.values() if image.has_pose), key=lambda i: i.name)
    parts = [_observations(image, rows) for image in photos]
    points, rays = ([part[side] for part in parts] for side in (0, 1))
    return Tracks(
        names=tuple(image.name for image in photos),
        photo=np.repeat(np.arange(len(photos), dtype=np.int32), [len(part) for part in points]),
        point=np.concatenate([np.empty(0, np.int32), *points]),
        rays=np.concatenate([np.empty((0, 2), np.float32), *rays]),
    )


def _observations(image, rows: dict[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """`[O]` rows of the points that a photo saw, and `[O, 2]` rays to them."""
    seen = image.get_observation_points2D()
    points = np.array([rows[keypoint.point3D_id] for keypoint in seen], np.int32)
    pixels = np.array([keypoint.xy for keypoint in seen], np.float64).reshape(-1, 2)
    rays = np.asarray(image.camera.cam_from_img(pixels), np.float64)[:, :2] if len(seen) else pixels
    usable = is_float32(rays).all(axis=1)
    return points[usable], rays[usable].astype(np.float32)


def _read_model(model: Path):
    pycolmap = require("pycolmap", "pip install pycolmap")
    suffix = ".bin" if (model / "cameras.bin").is_file() else ".txt"
    for part in PARTS:
        if not (model / (part + suffix)).is_file():
            raise InputError(f"{model / (part + suffix)}: missing from the COLMAP model")
    known = {int(m): name for name, m in pycolmap.CameraModelId.__members__.items() if name != "INVALID"}
    if suffix == ".txt":
        _check_text_cameras(model / "cameras.txt", set(known.values()))
    else:
        sizes = {i: len(pycolmap.Camera.create_from_model_name(0, name, 1.0, 1, 1).params) for i, name in known.items()}
        _check_binary(model / "cameras.bin", lambda data, at: _after_camera(data, at, sizes))
        _check_binary(model / "images.bin", _after_image)
        _check_binary(model / "points3D.bin", _after_point)
    try:
        with quiet(pycolmap):
            return pycolmap.Reconstruction(model)
    except (ValueError, IndexError, KeyError, RuntimeError, MemoryError, OSError) as error:
        reason = str(error).strip().splitlines()[0]
        raise InputError(f"{model}: COLMAP model is damaged or contradicts itself ({reason})") from error


def _photos(reconstruction, root: Path, model: Path) -> tuple[Photo, ...]:
    posed = sorted((i for i in reconstruction.images.values() if i.has_pose), key=lambda i: i.name)
    folder = _image_folder(root, model, [i.name for i in posed])
    suffix = ".bin" if (model / "cameras.bin").is_file() else ".txt"
    photos = []
    for image in posed:
        viewmat = np.eye(4)
        viewmat[:3] = image.cam_from_world().matrix()
        if not is_float32(viewmat).all():
            raise InputError(f"{model / ('images' + suffix)}: the pose of {image.name} is not finite")
        camera = image.camera
        lens = Lens(camera.model_name, int(camera.width), int(camera.height), tuple(map(float, camera.params)))
        check_lens(lens, model / f"cameras{suffix}")
        photos.append(Photo(image.name, folder / image.name, viewmat, lens))
    return tuple(photos)


def _image_folder(root: Path, model: Path, names: list[str]) -> Path:
    """Of the usual places, the one that holds most of the photos; the first of equals."""
    places = [root / "images", *(p / "images" for p in (model, *model.resolve().parents[:2])), root]
    return max(places, key=lambda place: sum(p.is_file() for p in found_files([place / name for name in names])))


def _check_text_cameras(path: Path, known: set[str]) -> None:
    lines = [line.split() for line in path.read_text(errors="replace").splitlines()]
    cameras = [words for words in lines if words and not words[0].startswith("#")]
    if not cameras:
        raise InputError(f"{path}: no camera in it")
    for words in cameras:
        if len(words) < 2 or words[1] not in known:
            raise InputError(f"{path}: unknown camera model {' '.join(words[1:2])!r} of camera {words[0]}")


def _check_binary(path: Path, after_record) -> None:
    """Walks the records of a COLMAP binary file: a count (uint64), then that many records."""
    data = path.read_bytes()
    try:
        (count,) = struct.unpack_from("<Q", data, 0)
        at = 8
        for _ in range(count):
            at = after_record(data, at)
            if at > len(data):
                raise struct.error
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (struct.error, ValueError):
        raise InputError(f"{path}: truncated, the records it promises do not fit its {len(data)} bytes") from None


def _after_camera(data: bytes, at: int, param_counts: dict[int, int]) -> int:
    """Id, model (int32), width, height (uint64), parameters (float64)."""
    camera, model, _, _ = struct.unpack_from("<IiQQ", data, at)
    if model not in param_counts:
        raise InputError(f"unknown camera model {model} of camera {camera}")
    return at + 24 + 8 * param_counts[model]


def _after_image(data: bytes, at: int) -> int:
    """Id, quaternion, translation, camera id, name ended by a zero, count, then 24 bytes a keypoint."""
    name_end = data.index(0, at + 64)
    (keypoints,) = struct.unpack_from("<Q", data, name_end + 1)
    return name_end + 9 + 24 * keypoints


def _after_point(data: bytes, at: int) -> int:
    """Id, position, colour, error, count, then 8 bytes for each element of the track."""
    (track,) = struct.unpack_from("<Q", data, at + 43)
    return at + 51 + 8 * track


@contextmanager
def quiet(pycolmap) -> Iterator[None]:
    """Keeps pycolmap's own log off the terminal; what matters of it comes as an exception."""
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = 4
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = level
