"""The steps of a reconstruction: photos, features, pairs, mapping, the place by GPS, and the data set."""

from pathlib import Path

from gsjax.errors import InputError
from gsjax.io.files import make_folder
from gsjax.io.georeference_files import write_place
from gsjax.io.images import SUFFIXES
from gsjax.io.parallel_map import Progress
from gsjax.io.sfm import (
    Options,
    dataset_writer,
    features,
    georeference,
    initial_cameras,
    learned,
    mapping,
    pairs,
    source_photos,
    video,
)


def build(source: Path, workspace: Path, options: Options, progress: Progress) -> dict:
    """Reconstruct a folder of photos or a video: leave `workspace/scene`, return the fields of the report."""
    mapping.pycolmap.set_random_seed(0)
    folder = _photo_folder(source, workspace, options, progress)
    photos, faults = source_photos.usable_photos(folder)
    if options.panoramas:
        photos = source_photos.as_panoramas(photos, options.mask_below)
    hint = "" if options.panoramas else source_photos.panorama_hint(photos)
    if options.weights is None:
        detected, matcher = features.find_features(photos, progress), None
    else:
        weights, matcher = Path(options.weights), options.matcher_weights and Path(options.matcher_weights)
        detected, matcher = learned.find_features(photos, options.features, weights, matcher, progress)
    scores = pairs.likeness(detected, progress)
    priors, ignored_focals = initial_cameras.focal_priors(photos)
    material = mapping.Material(photos, detected, scores, [], matcher)
    try:
        model, left_out, second_mapping = mapping.map_photos_with_priors(material, priors, workspace, progress)
    except InputError as error:
        raise InputError(f"{source}: {error}{hint}") from error
    placed = georeference.place_model(model, photos)
    dataset_writer.write_dataset(model, photos, make_folder(workspace / "scene"), progress)
    write_place(workspace / "scene", placed.place)
    far = {photos[index].name: f"{metres:.0f} m from the photo's place" for index, metres in placed.errors.items()}
    return {
        "images": len(photos) + len(faults),
        "registered": model.num_reg_images(),
        "left_out": dict(faults) | {name: why + hint for name, why in left_out.items()},
        "passed_over": source_photos.unused_files(folder),
        "points": model.num_points3D(),
        "mean_reprojection_error": model.compute_mean_reprojection_error(),
        "mean_track_length": model.compute_mean_track_length(),
        "place": placed.summary,
        "focal_unused": ignored_focals,
        "second_mapping": second_mapping,
        "gps_unused": {photo.name: photo.fix for photo in photos if isinstance(photo.fix, str)} | far,
    }


def _photo_folder(source: Path, workspace: Path, options: Options, progress: Progress) -> Path:
    """The folder of photos, or that of the frames of a video."""
    if not source.is_file():
        return source
    if source.suffix.lower() in SUFFIXES:
        raise InputError(f"{source}: is one photo; give the folder that holds all of them")
    return video.write_sharpest_frames(source, workspace / "frames", options.frames, progress)
