"""Masks of photos by a segmentation network, for example of people or the sky."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io.files import atomic_folder, require_empty
from gsjax.io.images import write_image
from gsjax.io.photo_names import path_inside
from gsjax.io.scenes import is_data_set, list_photos
from gsjax.io.sfm.source_photos import SourcePhoto, list_source_photos, read_source_photo
from gsjax.networks.records import MASK_NETWORKS, MaskNetwork, read_record
from gsjax.networks.segmenter import Segmenter, chosen_classes


def masks(
    photos: str | Path,
    network: str | Path,
    weights: str | Path,
    out: str | Path | None = None,
    *,
    classes: Sequence[str] | None = None,
    invert: bool = False,
    images: str | None = None,
) -> dict[str, Any]:
    """Write a mask for every photo: 0 where it shows one of the classes, 255 elsewhere.

    The network sees each photo upright, as its EXIF orientation has it; the mask is as the file's pixels do, as
    `gsjax.io.scenes` and `gsjax.io.sfm` read masks.

    Args:
        photos: Folder of photos, see `gsjax.io.sfm.source_photos.list_source_photos`, or of a data set.
        network: A name of `gsjax.networks.records.MASK_NETWORKS`, or a JSON file with a record of one's own.
        weights: The network as an ONNX file.
        out: Folder to make, absent or empty; appears when everything is done. None: `masks` in `photos`, where the
            other commands search for it.
        classes: What to leave out, of the record's classes. None: the only one but the background.
        invert: Leave out everything else instead.
        images: Of a data set, the folder of the photos, absolute or in `photos`. None: searched for.

    Returns:
        `masks`: how many; `classes`; `left_out`: mean share of pixels that are 0; `photos_without`: how many show none
        of the classes; `provider`: what the network ran on, as onnxruntime calls it; `seconds_per_photo`; `licence`;
        `folder`.

    Raises:
        InputError: The photos, the record, a class, the weights or the folder cannot be used.
    """
    _, record = read_record(network, MASK_NETWORKS, lambda data: MaskNetwork)
    class_names = chosen_classes(record, classes)
    folder = Path(photos) / "masks" if out is None else Path(out)
    require_empty(folder)
    sources = _sources(Path(photos), images)
    segmenter = Segmenter(record, weights, class_names)
    left_out, without = [], 0
    began = time.perf_counter()
    with atomic_folder(folder) as new_folder:
        for source in tqdm(sources, desc=f"masks on {segmenter.graph.device}", unit="photo"):
            shows = segmenter(source.read_upright(), source.name)
            without += not shows.any()
            is_out = shows != invert
            left_out.append(is_out.mean())
            mask = np.where(is_out, np.uint8(0), np.uint8(255))
            write_image(new_folder / f"{path_inside(source.name)}.png", source.as_stored(mask))
    return {
        "masks": len(sources),
        "classes": ", ".join(class_names),
        "left_out": float(np.mean(left_out)),
        "photos_without": without,
        "provider": segmenter.graph.provider,
        "seconds_per_photo": (time.perf_counter() - began) / len(sources),
        "licence": record.licence,
        "folder": str(folder),
    }


def _sources(photos: Path, images: str | None) -> list[SourcePhoto]:
    if is_data_set(photos):
        return [read_source_photo(photo.path, photo.name) for photo in list_photos(photos, images)]
    if images is not None:
        raise InputError(f"images={images}: goes with a data set, and {photos} is a folder of photos")
    return list_source_photos(photos)
