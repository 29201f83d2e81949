"""The cameras that mapping starts from: one for all photos of one camera, with a focal length from EXIF or a guess."""

import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress

from gsjax.io.exif import tags_of
from gsjax.io.images import Image, open_image
from gsjax.io.packages import require
from gsjax.io.sfm.focal_lengths import CameraKey, usable_prior
from gsjax.io.sfm.source_photos import SourcePhoto

pycolmap = require("pycolmap")

_FULL_LENS_FROM = 5  # photos of one camera that determine two focal lengths and four numbers of distortion
_USUAL_FOCAL = 1.2  # longer sides of the photo, where EXIF states no focal length (COLMAP)
PANORAMA = "EQUIRECTANGULAR"  # COLMAP's camera of 360 x 180 degrees, which has no unknowns


def focal_priors(photos: Sequence[SourcePhoto]) -> tuple[dict[CameraKey, float], dict[str, str]]:
    """Return the focal lengths that EXIF states, pixels by camera; and by photo the reason why one is ignored."""
    by_camera = {photo.camera: photo for photo in photos if not photo.is_panorama}
    priors, ignored = {}, {}
    for camera, photo in by_camera.items():
        guess = _infer_camera(photo)
        if not guess.has_prior_focal_length:
            continue
        focal, reason = usable_prior(camera, by_camera, guess.mean_focal_length())
        if focal is None:
            ignored |= {other.name: reason for other in photos if other.camera == camera}
        else:
            priors[camera] = focal
    return priors, dict(sorted(ignored.items()))


def guess_cameras(photos: Sequence[SourcePhoto], priors: Mapping[CameraKey, float]) -> list:
    """Return a `pycolmap.Camera` for each photo, one for all of one camera, with the prior focal length or a guess."""
    keys = [photo.camera for photo in photos]
    cameras = {}
    for photo in photos:
        if photo.camera in cameras:
            continue
        number, (width, height) = len(cameras) + 1, photo.size
        if photo.is_panorama:
            camera = panorama_camera(number, width, height)
        else:
            model = "OPENCV" if keys.count(photo.camera) >= _FULL_LENS_FROM else "SIMPLE_RADIAL"
            focal = priors.get(photo.camera, _USUAL_FOCAL * width)
            camera = pycolmap.Camera.create_from_model_name(number, model, focal, width, height)
        camera.has_prior_focal_length = photo.is_panorama or photo.camera in priors
        cameras[photo.camera] = camera
    return [cameras[key] for key in keys]


def panorama_camera(number: int, width: int, height: int):
    """Return the `pycolmap.Camera` of panoramas."""
    return pycolmap.Camera(camera_id=number, model=PANORAMA, width=width, height=height, params=[width, height])


def _infer_camera(photo: SourcePhoto):
    """Return COLMAP's camera of a photo, by its EXIF."""
    with suppress(ValueError):  # Of formats that COLMAP does not read.
        return pycolmap.infer_camera_from_image(photo.path)
    with tempfile.NamedTemporaryFile(suffix=".jpg") as blank, open_image(photo.path) as picture:
        Image.new("L", picture.size).save(blank, "JPEG", exif=tags_of(picture))
        blank.flush()
        return pycolmap.infer_camera_from_image(blank.name)
