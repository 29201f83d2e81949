"""`transforms.json` as instant-ngp and nerfstudio write it, and the NeRF-synthetic layout.

Matrices are camera to world with OpenGL camera axes (x right, y up, looking along -z).
"""

import json
import math
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.images import image_size
from gsjax.io.lenses import Lens, check_lens, is_float32
from gsjax.io.photos import Capture, Photo, listed
from gsjax.io.ply import read_points

FILES = ("transforms.json", "transforms_train.json")  # Of instant-ngp and nerfstudio; of the NeRF-synthetic layout.

# For each `camera_model`: COLMAP's model and the coefficients it takes after fx, fy, cx, cy.
_MODELS = {
    "PINHOLE": ("PINHOLE", ()),
    "SIMPLE_PINHOLE": ("PINHOLE", ()),
    "OPENCV": ("FULL_OPENCV", ("k1", "k2", "p1", "p2", "k3", "", "", "")),
    "OPENCV_FISHEYE": ("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
}
_COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2")
_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_RANDOM_POINTS = 30_000
_SYNTHETIC_HALF_WIDTH = 1.3  # 3DGS, Blender scenes
_SEED = 0


def read_transforms(root: Path) -> Capture:
    """Photos and points of a folder with `transforms.json`.

    Points are those that `ply_file_path` names, or else random ones in a cube around the place nearest to all optical
    axes, as large as the median distance of the cameras from it, none nearer to a camera than a quarter of that.

    Raises:
        InputError: The file, or a file that it names, is missing, damaged or contradicts itself.
    """
    file = root / FILES[0]
    meta = _read_json(file)
    photos = _photos(file, meta)
    if meta.get("ply_file_path"):
        points, colors = read_points(root / meta["ply_file_path"])
        return Capture("transforms", photos, points, colors)
    return Capture("transforms", photos, *_points_in_view(np.stack([p.viewmat for p in photos])))


def read_synthetic(root: Path) -> Capture:
    """Photos of the NeRF-synthetic layout; those of `transforms_test.json` are held out.

    Points are random in [-1.3, 1.3]^3, as in 3DGS.

    Raises:
        InputError: A file is missing, damaged or contradicts itself.
    """
    train = root / FILES[1]
    photos = list(_photos(train, _read_json(train)))
    test = root / "transforms_test.json"
    if test.is_file():
        photos += _photos(test, _read_json(test), held_out=True)
    rng = np.random.default_rng(_SEED)
    points = rng.uniform(-_SYNTHETIC_HALF_WIDTH, _SYNTHETIC_HALF_WIDTH, (_RANDOM_POINTS, 3)).astype(np.float32)
    return Capture("nerf-synthetic", tuple(photos), points, _mid_tones(rng))


def _read_json(file: Path) -> dict:
    try:
        meta = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read as JSON ({error})") from error
    if not isinstance(meta, dict) or not isinstance(meta.get("frames"), list) or not meta["frames"]:
        raise InputError(f'{file}: has no list "frames"')
    return meta


def _photos(file: Path, meta: dict, held_out: bool = False) -> tuple[Photo, ...]:
    defaults = {key: value for key, value in meta.items() if key != "frames"}
    entries = [{**defaults, **frame} for frame in meta["frames"]]
    for number, entry in enumerate(entries):
        if not isinstance(entry.get("file_path"), str):
            raise InputError(f'{file}: frame {number} has no "file_path"')
    paths = [_existing(file.parent / entry["file_path"]) for entry in entries]
    # What says its size may lie in another folder: `gsjax.io.image_folders` looks for it.
    missing = [path for path, entry in zip(paths, entries, strict=True) if not (path.is_file() or _has_size(entry))]
    if missing:
        raise InputError(f"{file}: {listed('image', [p.relative_to(file.parent).as_posix() for p in missing])}")
    return tuple(
        Photo(
            name=_name(path, file.parent),
            path=path,
            viewmat=_viewmat(file, entry),
            lens=_lens(file, entry, path),
            mask_path=file.parent / entry["mask_path"] if entry.get("mask_path") else None,
            held_out=held_out,
        )
        for path, entry in zip(paths, entries, strict=True)
    )


def _has_size(entry: dict) -> bool:
    return bool(entry.get("w") and entry.get("h"))


def _existing(path: Path) -> Path:
    """The path, or the same with the suffix that the layout leaves out."""
    suffixes = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG")
    candidates = [path.with_name(path.name + suffix) for suffix in suffixes]
    return next((c for c in candidates if c.is_file()), path)


def _name(path: Path, root: Path) -> str:
    relative = path.resolve().relative_to(root.resolve()) if path.resolve().is_relative_to(root.resolve()) else path
    parts = relative.parts
    return "/".join(parts[1:]) if parts[0] == "images" and len(parts) > 1 else relative.as_posix()


def _viewmat(file: Path, entry: dict) -> np.ndarray:
    """World to camera; a rotation that is off by rounding is made exact."""
    where = f"{file}: transform_matrix of {entry['file_path']}"
    try:
        matrix = np.array(entry["transform_matrix"], np.float64)
    except (KeyError, ValueError, TypeError):
        matrix = np.empty(0)
    if matrix.shape not in ((4, 4), (3, 4)) or not is_float32(matrix).all():
        raise InputError(f"{where} is not a finite 4x4 matrix")
    camera_to_world = np.eye(4)
    camera_to_world[:3] = matrix[:3]
    left, stretch, right = np.linalg.svd(camera_to_world[:3, :3])
    if np.abs(stretch - 1).max() > 1e-2 or np.linalg.det(camera_to_world[:3, :3]) < 0:
        raise InputError(f"{where} is not a rotation and a translation (it stretches by {stretch.round(4).tolist()})")
    camera_to_world[:3, :3] = left @ right
    return np.linalg.inv(camera_to_world @ _OPENGL_TO_OPENCV)


def _lens(file: Path, entry: dict, path: Path) -> Lens:
    name = entry.get("camera_model") or ("OPENCV_FISHEYE" if entry.get("is_fisheye") else "OPENCV")
    try:
        width, height = (int(entry["w"]), int(entry["h"])) if _has_size(entry) else image_size(path)
        if name == "EQUIRECTANGULAR":
            return check_lens(Lens(name, width, height, (float(width), float(height))), file)
        fx, fy = _focal_lengths(file, entry, width, height)
        center = float(entry.get("cx", width / 2)), float(entry.get("cy", height / 2))
        given = {k: float(entry[k]) for k in _COEFFICIENTS if float(entry.get(k) or 0)}
    except InputError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"{file}: camera of {entry['file_path']}: {error}") from None
    if name not in _MODELS:
        raise InputError(f"{file}: unknown camera_model {name!r}; known are {', '.join(_MODELS)}, EQUIRECTANGULAR")
    model, coefficients = _MODELS[name]
    foreign = sorted(set(given) - set(coefficients))
    if foreign:
        raise InputError(f"{file}: camera_model {name} takes no {', '.join(foreign)} ({entry['file_path']})")
    if not given and name == "OPENCV":
        model, coefficients = "PINHOLE", ()
    return check_lens(Lens(model, width, height, (fx, fy, *center, *(given.get(k, 0.0) for k in coefficients))), file)


def _focal_lengths(file: Path, entry: dict, width: int, height: int) -> tuple[float, float]:
    """From `fl_x`, `fl_y`, or the angles of view; where one axis is missing, pixels are square."""
    fx = entry.get("fl_x") or _focal_of_angle(entry.get("camera_angle_x"), width)
    fy = entry.get("fl_y") or _focal_of_angle(entry.get("camera_angle_y"), height)
    if not fx and not fy:
        raise InputError(f"{file}: {entry['file_path']} has neither fl_x nor camera_angle_x")
    return float(fx or fy), float(fy or fx)


def _focal_of_angle(angle: float | None, side: int) -> float | None:
    return 0.5 * side / math.tan(0.5 * float(angle)) if angle else None


def _points_in_view(viewmats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(_SEED)
    centers = -np.einsum("nji,nj->ni", viewmats[:, :3, :3], viewmats[:, :3, 3])
    focus = _nearest_to_axes(centers, viewmats[:, 2, :3])
    reach = float(np.median(np.linalg.norm(centers - focus, axis=1))) or 1.0
    points = focus + rng.uniform(-reach, reach, (2 * _RANDOM_POINTS, 3))
    nearest = np.min([np.linalg.norm(points - center, axis=1) for center in centers], axis=0)
    clear = points[nearest > 0.25 * reach][:_RANDOM_POINTS]
    return clear.astype(np.float32), _mid_tones(rng)[: len(clear)]


def _nearest_to_axes(centers: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The point of least squared distance to all optical axes.

    Axes that are all but parallel meet nowhere in particular; a weak pull to one spread of the cameras ahead of
    them decides then.
    """
    spread = np.linalg.norm(centers - centers.mean(0), axis=1).max() or 1.0
    ahead = centers.mean(0) + spread * axes.mean(0)
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    weak = 1e-3 * len(centers) * np.eye(3)
    return np.linalg.solve(across.sum(0) + weak, np.einsum("nij,nj->i", across, centers) + weak @ ahead)


def _mid_tones(rng: np.random.Generator) -> np.ndarray:
    return rng.integers(64, 192, (_RANDOM_POINTS, 3), dtype=np.uint8)
