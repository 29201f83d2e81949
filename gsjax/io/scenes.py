"""A folder of photos with cameras, whatever its layout, as one `Scene`."""

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from operator import attrgetter
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io import colmap, transforms
from gsjax.io.bad_items import Fault, leave_out, read_usable
from gsjax.io.georeference_files import read_place
from gsjax.io.image_folders import locate_photos, masks_in
from gsjax.io.images import read_image
from gsjax.io.lenses import Lens, is_circular, principal_point
from gsjax.io.messages import print_once
from gsjax.io.photos import MASK_USES, Capture, Photo, frames_of, readable_photos
from gsjax.io.splits import AUTO, listed, mark_held_out
from gsjax.io.truth import load_truth
from gsjax.scene import Scene
from gsjax.scene import similarity as similarities
from gsjax.scene.georeference import Place
from gsjax.scene.similarity import Similarity

_name = attrgetter("name")

# The image circle of a fisheye lens, beyond which its photos are black and say nothing.
_LOOKED_AT = 3  # photos of a lens
_BLACK = 16  # of 255, at most, in every channel
# A ring of pixels belongs to the picture where more pixels are not black than this share and this number together.
_LIT_SHARE, _LIT_COUNT = 0.02, 3
_RINGS = 400  # from the principal point to the farthest corner
_CORNER = 0.95  # of that: a picture that goes farther is no circle
_MARGIN = 1.5  # pixels: at its rim the circle is mixed with black
_LEAST = 0.25  # of the shorter side: a smaller circle is no lens's, and all is dark


def load_scene(
    root: str | Path,
    *,
    downscale: float = 1.0,
    folder_masks: str = "valid",
    images: str | None = None,
    hold_out: str = AUTO,
    photos: str | None = None,
    similarity: Similarity | None = None,
    place: Place | None = None,
    masks: Path | None = None,
) -> Scene:
    """Loads a data set: COLMAP, `transforms.json` (instant-ngp, nerfstudio) or NeRF-synthetic.

    A COLMAP model is searched in `sparse/0` (or a larger one in `sparse/1` and so on), `sparse`, `colmap/sparse/0`
    and the folder itself; its photos in `images/` or next to it, or in reduced copies (`gsjax.io.image_folders`).
    Photos of another size than their camera says rescale its intrinsics where the shape fits. Lens distortion is
    removed. Masks come from a folder `masks/` (`gsjax.io.image_folders.masks_in`), from `mask_path` in
    `transforms.json`, or from the photos' alpha channel, which always becomes the matte. Truth is listed too.

    Args:
        root: Folder of the data set.
        downscale: Images, masks, truth and intrinsics are this many times smaller, at least 1.
        folder_masks: What masks from files mean: "valid", 0 is ignored; "matte", the object's coverage.
        images: Folder of the photos, absolute or in `root`; None: they are searched.
        hold_out: Which photos are for scoring only, see `gsjax.io.splits.mark_held_out`.
        photos: Text file of the names of those that are taken, one a line, as `hold_out` may be one; None: all. Which
            of them are held out is decided among all.
        similarity: From the coordinates of the world to those of the scene. None: by its cameras
            (`gsjax.scene.similarity.of_cameras`); it changes nothing of a scene of usual size at its origin.
        place: Which world the files' coordinates are converted to. None: as `place.json` in the folder says, without
            which it is that of the files.
        masks: Folder of the masks. None: `masks/` in the folder.

    Raises:
        InputError: The folder is no data set, or a file in it is unusable; one line naming the file and the fault.
    """
    root = Path(root)
    if not (math.isfinite(downscale) and downscale >= 1):
        raise InputError(f"downscale must be a number of at least 1, not {downscale}")
    if folder_masks not in MASK_USES:
        raise InputError(f"folder_masks must be one of {', '.join(MASK_USES)}, not {folder_masks!r}")
    capture = _read_capture(root)
    selection = mark_held_out(_checked_photos(root, locate_photos(root, capture.photos, images)), hold_out, root)
    selection = _with_folder_masks(_named_in_file(selection, photos), root / "masks" if masks is None else masks)
    selection = with_image_circles(readable_photos(selection))
    place = read_place(root) if place is None else place
    selection = [replace(photo, viewmat=place.viewmat_to_world(photo.viewmat)) for photo in selection]
    capture = replace(capture, points=place.points_to_world(capture.points))
    if similarity is None:
        similarity = similarities.of_cameras(np.stack([photo.viewmat for photo in selection]), capture.points)
    if not similarity.is_possible:
        raise InputError(f"{root}: its cameras are too far off, or together, for float64 ({similarity.summary})")
    selection = [replace(photo, viewmat=similarity.viewmat_to_local(photo.viewmat)) for photo in selection]
    points = similarity.points_to_local(capture.points)
    frames_by_photo, faults = read_usable(selection, _name, lambda photo: frames_of(photo, downscale, folder_masks))
    leave_out("photos", faults, len(selection))
    frames = tuple(sorted((frame for each in frames_by_photo for frame in each), key=lambda frame: frame.name))
    truth = load_truth(root, frames, similarity, place)
    return Scene(root, capture.source, frames, points, capture.point_colors, truth, capture.tracks, similarity, place)


def list_photos(root: str | Path, images: str | None = None) -> list[Photo]:
    """The photos of a data set by name, with the files that they are in."""
    root = Path(root)
    return readable_photos(_checked_photos(root, locate_photos(root, _read_capture(root).photos, images)))


def is_data_set(root: str | Path) -> bool:
    """Whether a folder is laid out as one that `load_scene` reads; the contents of the files are ignored."""
    root = Path(root)
    return colmap.find_model(root) is not None or any((root / file).is_file() for file in transforms.FILES)


def _read_capture(root: Path) -> Capture:
    if not os.path.isdir(root):  # Unlike Path, also of a name that is too long.
        raise InputError(f"{root}: no such folder")
    model = colmap.find_model(root)
    if model is not None:
        others = [file for file in transforms.FILES if (root / file).is_file()]
        if others:
            print_once(f"{root}: the COLMAP model {model} is read, and not {others[0]}")
        return colmap.read_capture(root, model)
    for file, read in zip(transforms.FILES, (transforms.read_transforms, transforms.read_synthetic), strict=True):
        if (root / file).is_file():
            return read(root)
    places = ", ".join(f"{folder}/cameras.bin or .txt" for folder in ("sparse/0", "sparse", "colmap/sparse/0", "."))
    raise InputError(f"{root}: no data set; searched {places}, {', '.join(transforms.FILES)}")


def _checked_photos(root: Path, photos: Sequence[Photo]) -> list[Photo]:
    """The photos sorted by name: at least two, no name twice, none for testing whose file is missing."""
    missing = {photo.path for photo in photos if photo.held_out and not os.path.isfile(photo.path)}
    faults = [Fault(photo.name, f"{photo.path}: no such image") for photo in photos if photo.path in missing]
    leave_out("photos for testing", faults, sum(photo.held_out for photo in photos), needed=0)
    photos = _without_repeated(sorted((photo for photo in photos if photo.path not in missing), key=_name))
    if len(photos) < 2:
        raise InputError(f"{root}: {len(photos)} posed image in it, at least 2 are needed")
    return photos


def _without_repeated(photos: Sequence[Photo]) -> list[Photo]:
    """The photos, sorted by name; of those that are listed repeatedly the first, or none where cameras differ."""
    by_name = {name: list(same) for name, same in groupby(photos, key=_name)}
    repeated = {name: same for name, same in by_name.items() if len(same) > 1}
    differ = {
        name
        for name, (first, *more) in repeated.items()
        if not all(first.lens == other.lens and np.array_equal(first.viewmat, other.viewmat) for other in more)
    }
    messages = {name: f"{same[0].path}: is listed more than once" for name, same in repeated.items()}
    alike = [Fault(name, messages[name]) for name, same in repeated.items() if name not in differ for _ in same[1:]]
    leave_out("listed photos", alike, len(photos), needed=0)
    leave_out(
        "photos", [Fault(name, f"{messages[name]}, with several cameras") for name in sorted(differ)], len(by_name)
    )
    return [same[0] for name, same in by_name.items() if name not in differ]


def _named_in_file(photos: list[Photo], file: str | None) -> list[Photo]:
    """Those that a file names; two at least."""
    if file is None:
        return photos
    names = listed(Path(file), [photo.name for photo in photos])
    if len(names) < 2:
        raise InputError(f"{file}: names one photo, at least 2 are needed")
    return [photo for photo in photos if photo.name in names]


def _with_folder_masks(photos: list[Photo], folder: Path) -> list[Photo]:
    """Gives photos the masks of a folder; a photo without one is used whole."""
    if not folder.is_dir():
        return photos
    masks = masks_in(folder, [photo.name for photo in photos])
    with_masks = [replace(photo, mask_path=masks.get(photo.name, photo.mask_path)) for photo in photos]
    if all(photo.mask_path is None for photo in with_masks):
        raise InputError(f"{folder}: no mask in it has the name of an image, for example {photos[0].name}.png")
    return with_masks


def with_image_circles(photos: Sequence[Photo]) -> list[Photo]:
    """The photos, those of circular fisheyes with lenses that know how far their picture goes: a few are read."""
    circular = {lens for lens in {photo.lens for photo in photos} if is_circular(lens)}
    measured_lenses = {lens: replace(lens, reach=_reach(lens, photos)) for lens in circular}
    return [replace(photo, lens=measured_lenses.get(photo.lens, photo.lens)) for photo in photos]


def _reach(lens: Lens, photos: Sequence[Photo]) -> float:
    """As `Lens.reach`: to the outermost ring that is not black in one of the photos; infinite where all are dark."""
    own = [photo for photo in photos if photo.lens == lens]
    spread = {round(index) for index in np.linspace(0, len(own) - 1, _LOOKED_AT)}
    reach = max(_lit_reach(lens, read_image(own[index].path)[0]) for index in spread)
    return reach if reach * lens.width > _LEAST * min(lens.width, lens.height) else math.inf


def _lit_reach(lens: Lens, colors: np.ndarray) -> float:
    """Of a photo's width, how far from the principal point it is not black; infinite where it is not at its corners."""
    height, width = colors.shape[:2]
    x, y = principal_point(lens) * [width / lens.width, height / lens.height]
    radii = np.hypot(np.arange(width) + 0.5 - x, (np.arange(height) + 0.5 - y)[:, None])
    rings = (radii / radii.max() * (_RINGS - 1)).astype(int)
    pixels, lit = (np.bincount(rings.ravel(), weights, _RINGS) for weights in (None, (colors > _BLACK).any(-1).ravel()))
    outermost = np.flatnonzero(lit > _LIT_SHARE * pixels + _LIT_COUNT).max(initial=0)
    share = outermost / (_RINGS - 1)
    return math.inf if share > _CORNER else (share * radii.max() - _MARGIN) / width
