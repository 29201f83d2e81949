"""From features to a model: verified matches, COLMAP's incremental mapping, and further pairs for photos outside it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io.colmap_writer import write_whole
from gsjax.io.files import make_folder
from gsjax.io.packages import require
from gsjax.io.parallel_map import Progress, map_with_bar, thread_count
from gsjax.io.sfm.features import Features, Region, epipolar_regions, homography_regions, match
from gsjax.io.sfm.focal_lengths import CameraKey
from gsjax.io.sfm.gps import Fix
from gsjax.io.sfm.initial_cameras import PANORAMA, guess_cameras
from gsjax.io.sfm.pairs import Pair, bridging_pairs, choose_pairs, likeliest_pairs, nearby_pairs
from gsjax.io.sfm.source_photos import SourcePhoto

pycolmap = require("pycolmap")

_FEWEST_MATCHES = 15  # of a pair, after verification
_ENOUGH_MATCHES = 500  # of a pair; with fewer, more are sought where the geometry of the pair puts them
_BRIDGING_ROUNDS = 2
_SELF_CALIBRATE_FROM = 20  # registered photos of one camera that pin its principal point down
_SEED = 0


@dataclass(frozen=True)
class Material:
    """The input of mapping."""

    photos: list[SourcePhoto]
    features: list[Features]
    scores: np.ndarray  # [V, V] int, likeness of photos
    cameras: list  # pycolmap.Camera of each photo, shared by the photos of one
    matcher: Callable[[int, int], np.ndarray] | None = None  # of two photos' features; None: nearest descriptors


def match_photos(material: Material, progress: Progress) -> tuple[dict[Pair, Any], set[Pair]]:
    """Match the chosen pairs and those near by GPS, then others that may join separate parts.

    Returns:
        The geometry (`pycolmap.TwoViewGeometry`) of the pairs that match, and all pairs that were tried.
    """
    fixes = [photo.fix if isinstance(photo.fix, Fix) else None for photo in material.photos]
    pairs = choose_pairs(material.scores) | nearby_pairs(fixes)
    geometries = match_pairs(material, pairs, "matching", progress)
    for _ in range(_BRIDGING_ROUNDS):
        more = bridging_pairs(material.scores, geometries, pairs)
        if not more:
            break
        geometries |= match_pairs(material, more, "matching the rest", progress)
        pairs |= more
    return geometries, pairs


def match_pairs(material: Material, pairs: set[Pair], title: str, progress: Progress) -> dict[Pair, Any]:
    """Return the geometry of those pairs that match and move as a rigid scene would."""
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = _FEWEST_MATCHES
    options.ransac.random_seed = _SEED

    def verified(pair: Pair):
        a, b = (material.features[photo] for photo in pair)
        matches = material.matcher(*pair) if material.matcher else match(a.unit(), b.unit(), nearness=a.nearness)
        if len(matches) < _FEWEST_MATCHES:
            return None
        cameras = [material.cameras[photo] for photo in pair]
        geometry = pycolmap.estimate_two_view_geometry(cameras[0], a.xy, cameras[1], b.xy, matches, options)
        if len(geometry.inlier_matches) < _FEWEST_MATCHES:
            return None
        if len(geometry.inlier_matches) < _ENOUGH_MATCHES and (within := _regions(geometry, a, b, *cameras)):
            # Fewer candidates: more matches are clearly nearer than the second nearest.
            guided = match(a.unit(), b.unit(), within, a.nearness)
            geometry.inlier_matches = max(geometry.inlier_matches, guided, key=len)
        return geometry

    ordered = sorted(pairs)
    geometries = map_with_bar(verified, ordered, progress, title, "pair")
    return {pair: geometry for pair, geometry in zip(ordered, geometries, strict=True) if geometry is not None}


def _regions(geometry, a: Features, b: Features, first, second) -> tuple[Region, Region] | None:
    """Return the regions of matches: along epipolar lines, or about points where one plane fills both photos."""
    kinds = pycolmap.TwoViewGeometryConfiguration
    if PANORAMA in (first.model_name, second.model_name):  # Their epipolar lines are curves.
        return None
    if geometry.config == kinds.UNCALIBRATED:
        return epipolar_regions(a, b, geometry.F)
    if geometry.config == kinds.CALIBRATED:
        into_first, into_second = (np.linalg.inv(camera.calibration_matrix()) for camera in (first, second))
        return epipolar_regions(a, b, into_second.T @ geometry.E @ into_first)
    if geometry.config in (kinds.PLANAR, kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC):
        return homography_regions(a, b, geometry.H)
    return None


def map_photos(material: Material, workspace: Path, progress: Progress) -> tuple[Any, dict[str, str]]:
    """Make the largest model, and give the reasons why photos are not in it.

    Returns:
        `pycolmap.Reconstruction` whose image ids count the photos from 1, and reasons by the names of photos left out.

    Raises:
        InputError: No two photos give a model.
    """
    geometries, pairs = match_photos(material, progress)
    models = _map(material, geometries, workspace / "first", None, progress)
    if not models:
        matched = len({photo for pair in geometries for photo in pair})
        raise InputError(
            f"no model found; {matched} of {len(material.photos)} photos match another one:"
            " take photos that overlap by two thirds, from different places"
        )
    model = max(models, key=lambda model: (model.num_reg_images(), model.num_points3D()))
    inside = _registered(model)
    outside = {photo for pair in geometries for photo in pair} - inside
    more = likeliest_pairs(material.scores, outside, inside, pairs) if outside else set()
    if more and (new_geometries := match_pairs(material, more, "matching the rest", progress)):
        write_whole(model, workspace / "largest")
        again = _map(material, geometries | new_geometries, workspace / "second", workspace / "largest", progress)
        model = max([model, *again], key=lambda model: model.num_reg_images())
    _self_calibrate(model)
    return model, _reasons(material, geometries, models, model)


def map_photos_with_priors(
    material: Material, priors: Mapping[CameraKey, float], workspace: Path, progress: Progress
) -> tuple[Any, dict[str, str], str]:
    """Run `map_photos`, and once more without prior focal lengths where less than half of the photos get a pose.

    Returns:
        The model of more photos, the reasons of those left out, and a line on the second mapping, or "".

    Raises:
        InputError: No two photos give a model, with the priors or without.
    """

    def attempt(focals: Mapping[CameraKey, float], name: str) -> tuple[tuple[int, int], Any]:
        """Return the numbers of photos and points, and the model with its reasons, or the error."""
        guessed = replace(material, cameras=guess_cameras(material.photos, focals))
        try:
            model, reasons = map_photos(guessed, make_folder(workspace / name), progress)
        except InputError as error:
            return (0, 0), error
        return (model.num_reg_images(), model.num_points3D()), (model, reasons)

    count, line = len(material.photos), ""
    size, outcome = attempt(priors, "priors")
    if priors and 2 * size[0] < count:
        size_without, outcome_without = attempt({}, "no_priors")
        words = "without" if size_without > size else "with"
        line = (
            f"{size[0]} of {count} photos get a pose with the focal lengths of EXIF, {size_without[0]} without them;"
            f" the model {words} them is kept"
        )
        outcome = outcome_without if words == "without" else outcome
    if isinstance(outcome, InputError):
        raise outcome
    return *outcome, line


def _map(
    material: Material, geometries: Mapping[Pair, Any], folder: Path, start: Path | None, progress: Progress
) -> list:
    """Run COLMAP's incremental mapping, from the model in the folder `start` where one is given."""
    database = make_folder(folder) / "database.db"
    _write_database(database, material, geometries)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = thread_count()
    options.random_seed = _SEED
    options.min_model_size = 2
    options.extract_colors = False  # It would read the photos as they are stored.
    with progress(total=len(material.photos), desc="mapping", unit="photo") as bar:

        def started() -> None:
            bar.reset()
            bar.update(2)

        models = pycolmap.incremental_mapping(
            database,
            folder,
            folder,
            options,
            start or "",
            initial_image_pair_callback=started,
            next_image_callback=lambda: bar.update(1),
        )
    return list(models.values())


def _write_database(path: Path, material: Material, geometries: Mapping[Pair, Any]) -> None:
    """Image ids count the photos from 1; each camera is a rig of its own, each photo a frame of it."""
    with pycolmap.Database.open(path) as database:
        for camera in {camera.camera_id: camera for camera in material.cameras}.values():
            database.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=camera.camera_id)
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, use_rig_id=True)
        photos = zip(material.photos, material.cameras, material.features, strict=True)
        for number, (photo, camera, features) in enumerate(photos, start=1):
            image = pycolmap.Image(name=photo.name, camera_id=camera.camera_id, image_id=number)
            database.write_image(image, use_image_id=True)
            frame = pycolmap.Frame(frame_id=number, rig_id=camera.camera_id)
            frame.add_data_id(image.data_id)
            database.write_frame(frame, use_frame_id=True)
            database.write_keypoints(number, features.xy.astype(np.float32))
        for (i, j), geometry in geometries.items():
            database.write_two_view_geometry(i + 1, j + 1, geometry)


def _self_calibrate(model) -> None:
    """Refine principal points too, which mapping holds at the centre: those of phones are off by a percent or more."""
    shares = [model.image(image).camera_id for image in model.reg_image_ids()]
    few = [
        camera
        for camera in set(shares)
        if shares.count(camera) < _SELF_CALIBRATE_FROM or model.camera(camera).model_name == PANORAMA
    ]
    if len(few) == len(set(shares)):
        return
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = True
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1  # wrong matches must not bend the camera
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.reg_image_ids():
        config.add_image(image)
    for camera in few:
        config.set_constant_cam_intrinsics(camera)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    # The shorter `pycolmap.bundle_adjustment` switches COLMAP's log back on.
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    model.update_point_3d_errors()


def _reasons(material: Material, geometries: Mapping[Pair, Any], models: list, model) -> dict[str, str]:
    """Return by name why each photo outside the model is not in it."""
    reasons = dict.fromkeys(range(len(material.photos)), "no match with any other photo")
    reasons |= {photo: "matched, but too little to be placed" for pair in geometries for photo in pair}
    for other in models:
        reasons |= dict.fromkeys(_registered(other), f"in a separate model of {other.num_reg_images()} photos")
    inside = _registered(model)
    return {material.photos[photo].name: reason for photo, reason in reasons.items() if photo not in inside}


def _registered(model) -> set[int]:
    """Return the photos of a model, by their index."""
    return {image - 1 for image in model.reg_image_ids()}
