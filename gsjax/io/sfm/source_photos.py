"""Photos in a folder, with camera, orientation, mask, GPS and gravity of each.

Structure from motion works in the sensor's frame, which is broader than high in any orientation of the camera, so that
photos of one camera share their intrinsics. The data set that it writes is upright.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io import exif
from gsjax.io.bad_items import Fault, leave_out, read_usable, require_enough
from gsjax.io.image_folders import MASK_ENDS, REDUCED, masks_in
from gsjax.io.images import SUFFIXES, check_image, cv2, open_image, read_image, read_mask, same_shape
from gsjax.io.messages import print_once
from gsjax.io.photos import says_nothing
from gsjax.io.sfm import gps
from gsjax.io.sfm.focal_lengths import CameraKey, read_focal
from gsjax.io.sfm.gravity import Vector, read_gravity

_MASKS = "masks", "mask"  # what the folder may be called, in any case
_MARKS_OF_OUTPUT = "sparse", "report.html"  # in data sets, runs and scans: their pictures are no photos
# Nor are pictures in folders of these names.
_OTHERS = {*REDUCED, "depth", "depths", "confidence", "normals", "sky", "thumbnails", "thumbs", "@eadir"}
_MAKE, _MODEL = 0x010F, 0x0110
# EXIF orientation: whether the stored columns run backwards, then quarter turns clockwise until upright.
_ORIENTATIONS = {1: (0, 0), 2: (1, 0), 3: (0, 2), 4: (1, 2), 5: (1, 3), 6: (0, 1), 7: (1, 1), 8: (0, 3)}


@dataclass(frozen=True)
class SourcePhoto:
    """One photo, not yet read."""

    name: str  # relative to the folder
    path: Path
    camera: CameraKey  # equal for the photos of one camera, held upright or across
    mirrored: bool  # the stored columns run backwards
    to_sensor: int  # quarter turns anticlockwise, from the stored pixels to the sensor's frame
    to_upright: int  # quarter turns clockwise, from the sensor's frame to upright
    mask_path: Path | None = None
    fix: gps.Fix | str | None = None  # position by GPS; words for its fault; None: unknown
    gravity: Vector | None = None  # unit vector down in the upright photo, where the device recorded it
    is_panorama: bool = False  # equirectangular: 360 degrees across, 180 down
    mask_below: float | None = None  # of a panorama, degrees below the horizon from which on it is masked

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in the sensor's frame, pixels; width is never the smaller."""
        return self.camera[-2:]

    def read(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Read `[H, W, 3]` uint8 in the sensor's frame, and the matte `[H, W]` uint8 where the photo has one.

        Raises:
            InputError: The file is damaged.
        """
        colors, alpha = read_image(self.path)
        return self._in_sensor(colors), None if alpha is None or says_nothing(alpha) else self._in_sensor(alpha)

    def read_mask(self) -> np.ndarray | None:
        """Read the mask `[H, W]` uint8 in the sensor's frame; None where nothing is masked.

        A mask file is oriented as the photo's stored pixels, or as the upright photo; its shape decides.

        Raises:
            InputError: The file is damaged, or of another shape than the photo.
        """
        mask, (width, height) = self._file_mask(), self.size
        if self.mask_below is None:
            return mask
        degrees = 180 * (np.arange(height) + 0.5) / height - 90  # below the horizon
        above = np.repeat(np.where(degrees < self.mask_below, np.uint8(255), np.uint8(0))[:, None], width, axis=1)
        return above if mask is None else np.minimum(mask, above)

    def _file_mask(self) -> np.ndarray | None:
        if self.mask_path is None:
            return None
        mask, (width, height) = read_mask(self.mask_path), self.size
        turned = [self._in_sensor(mask), np.rot90(mask, self.to_upright)]
        turned = [np.ascontiguousarray(one) for one in turned if same_shape(one.shape[::-1], self.size)]
        if not turned:
            shape = f"{mask.shape[1]}x{mask.shape[0]}"
            raise InputError(f"{self.mask_path}: mask is {shape}, of another shape than {self.path}")
        if turned[0].shape == (height, width):
            return turned[0]
        return cv2.resize(turned[0], (width, height), interpolation=cv2.INTER_NEAREST)

    def _in_sensor(self, stored: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.rot90(stored[:, ::-1] if self.mirrored else stored, self.to_sensor))

    def upright(self, colors: np.ndarray) -> np.ndarray:
        """Turn pixels `[H, W, ...]` of the sensor's frame upright."""
        return np.rot90(colors, -self.to_upright)

    def read_upright(self) -> np.ndarray:
        """Read `[H, W, 3]` uint8 of the upright photo.

        Raises:
            InputError: The file is damaged.
        """
        return np.ascontiguousarray(self.upright(self._in_sensor(read_image(self.path)[0])))

    def as_stored(self, upright: np.ndarray) -> np.ndarray:
        """Turn pixels `[H, W, ...]` of the upright photo as the file stores them."""
        stored = np.rot90(upright, self.to_upright - self.to_sensor)
        return stored[:, ::-1] if self.mirrored else stored


def list_source_photos(folder: Path) -> list[SourcePhoto]:
    """Return the photos of `usable_photos`; a line on stderr names the others."""
    photos, faults = usable_photos(folder)
    leave_out("photos", faults, len(photos) + len(faults))
    return photos


def usable_photos(folder: Path) -> tuple[list[SourcePhoto], list[Fault]]:
    """List the photos of a folder and its subfolders, by name, with their masks; and the faults of damaged ones.

    Where all photos are in a subfolder `images/`, that is their folder. A folder `masks/` or `mask/`, in any case, in
    it, next to it or next to photos holds masks (`gsjax.io.image_folders`), no photos. A file next to a photo is its
    mask if its name is that of the photo and ends in `MASK_ENDS`. Data sets, runs, scans, and folders of derived
    pictures such as `depth` or `thumbnails` hold no photos.

    Raises:
        InputError: No folder, fewer than two photos, too few that are whole (`gsjax.io.bad_items`), or masks of which
            none is a photo's.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of photos")
    root, listed_files, derived_folders = _scan(folder)
    pictures = {file.relative_to(root).as_posix(): file for file in listed_files if _is_photo(file)}
    beside = _masks_beside(pictures)
    files = {name: file for name, file in pictures.items() if file not in beside.values()}
    if len(files) < 2:
        hint = "".join(f"; what {path} holds was made of photos" for path in sorted(derived_folders)[:1])
        raise InputError(f"{folder}: needs at least 2 photos ({', '.join(SUFFIXES)}), has {len(files)}{hint}")
    masks = {**_masks_in_folders(root, files), **beside}

    def read(name: str) -> SourcePhoto:
        check_image(files[name])
        if name in masks:
            check_image(masks[name])
        return read_source_photo(files[name], name, masks.get(name))

    photos, faults = read_usable(files, str, read)
    require_enough("photos", faults, len(files))
    return photos, faults


def _masks_beside(pictures: Mapping[str, Path]) -> dict[str, Path]:
    """Return the masks in the folders of photos, by the photo's name."""
    ends = {end: len(end) for end in MASK_ENDS}
    of = {f: n[:-cut] for n, f in pictures.items() for end, cut in ends.items() if n.lower().endswith(end)}
    by_stem = {os.path.splitext(name)[0]: name for name, file in pictures.items() if file not in of}
    photo_of = {file: name if name in pictures else by_stem.get(name) for file, name in of.items()}
    return {name: file for file, name in photo_of.items() if name is not None}


def _masks_in_folders(root: Path, photos: Mapping[str, Path]) -> dict[str, Path]:
    """Return the masks in the first folder of masks in or next to the photos' folder, else in folders of photos."""
    folders = [path for place in (root, root.parent) for path in _mask_folders(place) if path != root]
    masks = masks_in(folders[0], photos) if folders else {}
    for parent in {file.parent for file in photos.values()} - {root}:
        within = {file.name: name for name, file in photos.items() if file.parent == parent and name not in masks}
        for folder in _mask_folders(parent)[:1]:
            masks |= {within[file]: mask for file, mask in masks_in(folder, within).items()}
    if not masks and folders and folders[0].parent == root and any(map(_is_photo, folders[0].rglob("*"))):
        raise InputError(f"{folders[0]}: no mask in it has the name of a photo, for example {next(iter(photos))}.png")
    return masks


def as_panoramas(photos: list[SourcePhoto], mask_below: float | None) -> list[SourcePhoto]:
    """Return the photos as equirectangular panoramas, masked from `mask_below` degrees below the horizon on.

    Raises:
        InputError: One of them is not twice as broad as high, or is on its side.
    """
    for photo in photos:
        if not _is_panoramic(photo):
            width, height = photo.size
            raise InputError(f"{photo.path}: is {width}x{height}; a panorama of 360 degrees is twice as broad as high")
        if photo.to_sensor or photo.to_upright or photo.mirrored:
            raise InputError(f"{photo.path}: is a panorama that its EXIF orientation turns; save it upright")
    return [replace(photo, is_panorama=True, mask_below=mask_below, gravity=None) for photo in photos]


def panorama_hint(photos: list[SourcePhoto]) -> str:
    """Return a hint, where all photos have the shape of panoramas, for the reason why photos have no pose."""
    return "; if it shows 360 degrees, set panoramas" if all(_is_panoramic(photo) for photo in photos) else ""


def _is_panoramic(photo: SourcePhoto) -> bool:
    width, height = photo.size
    return abs(width - 2 * height) <= 1


def unused_files(folder: Path) -> dict[str, str]:
    """Return by name why other files of a folder are not photos; hidden ones are left out."""
    root, files, derived_folders = _scan(folder)
    unused = dict.fromkeys(sorted(derived_folders), "was made of photos, by this program or another")
    for file in files:
        if not _is_photo(file):
            unused[file] = f"{file.suffix.lower() or 'no ending'} is no format of photos that is read"
    return {path.relative_to(root).as_posix(): reason for path, reason in unused.items()}


def _scan(folder: Path) -> tuple[Path, list[Path], set[Path]]:
    """Return the folder of photos, its files but hidden ones, masks and derived pictures, and the folders of these.

    Derived pictures are in folders within that hold a data set, a run or a scan, or have a name of such pictures.
    """
    inner = folder / "images"
    root = inner if inner.is_dir() and not any(map(_is_photo, folder.glob("*"))) else folder
    paths = list(root.rglob("*"))
    derived = {path for path in paths if path.name.casefold() in _OTHERS and path.is_dir()}
    derived |= {path.parent for path in paths if path.name in _MARKS_OF_OUTPUT} - {root}
    others = derived | {path for path in paths if path.name.casefold() in _MASKS and path.is_dir()}
    files = [path for path in paths if os.path.isfile(path) and others.isdisjoint(path.parents)]
    visible_files = [file for file in files if not any(part.startswith(".") for part in file.relative_to(root).parts)]
    return root, sorted(visible_files), derived


def _mask_folders(place: Path) -> list[Path]:
    """List the folders of masks in a folder, the most usual name first."""
    folders = [path for path in place.glob("*") if path.name.casefold() in _MASKS and path.is_dir()]
    return sorted(folders, key=lambda path: (_MASKS.index(path.name.casefold()), path))


def _is_photo(file: Path) -> bool:
    return file.suffix.lower() in SUFFIXES


def turned_pose(pose: np.ndarray, turns: int) -> np.ndarray:
    """Turn a pose `[3, 4]` (world to camera) with its picture, clockwise by quarter turns."""
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    return np.linalg.matrix_power(quarter, turns) @ pose


def turned_points(xy: np.ndarray, width: float, height: float, turns: int) -> np.ndarray:
    """Turn pixels `[N, 2]` with a picture of the given size, clockwise by quarter turns."""
    for _ in range(turns):
        xy, width, height = np.stack([height - xy[:, 1], xy[:, 0]], axis=-1), height, width
    return xy


def turned_pinhole(
    K: np.ndarray, width: int, height: int, turns: int
) -> tuple[tuple[float, float, float, float], int, int]:
    """Return COLMAP's PINHOLE parameters (fx, fy, cx, cy), width and height after quarter turns clockwise."""
    fx, fy = (K[0, 0], K[1, 1]) if turns % 2 == 0 else (K[1, 1], K[0, 0])
    ((cx, cy),) = turned_points(K[None, :2, 2], width, height, turns)
    return (fx, fy, cx, cy), *((width, height) if turns % 2 == 0 else (height, width))


def read_source_photo(path: Path, name: str, mask_path: Path | None = None) -> SourcePhoto:
    """Read the header of a photo's file, which the data set calls `name`.

    Raises:
        InputError: The file is missing or no image.
    """
    with open_image(path) as picture:
        (width, height), orientation, tags = picture.size, exif.orientation_of(picture), exif.tags_of(picture)
        details = exif.table_of(tags, exif.DETAILS)
        try:
            fix = gps.read_fix(tags.get_ifd(gps.TAG))
        except Exception:  # Pillow's many ways to say "damaged".
            fix = "its table of GPS is damaged"
        gravity = read_gravity(details, picture.info.get("xmp"))
    if orientation is None:
        print_once(f"{path}: its EXIF is damaged; the photo is taken as it is stored, upright or not")
    mirrored, turns = _ORIENTATIONS[orientation or 1]
    standing = int(height > width)
    make, model = (str(tags.get(tag, "")) for tag in (_MAKE, _MODEL))
    camera = (make, model, read_focal(details), max(width, height), min(width, height))
    return SourcePhoto(name, path, camera, bool(mirrored), standing, (turns + standing) % 4, mask_path, fix, gravity)
