"""The cameras that mapping starts from: one for all photos of one camera, with a focal length from EXIF or a guess."""

import tempfile
from collections.abc import Mapping
from contextlib import suppress

from gsjax.io.exif import tags_of
from gsjax.io.images import Image, open_image
from gsjax.io.packages import require
from gsjax.io.sfm.focal_lengths import CameraKey, usable_prior
from gsjax.io.sfm.shots import Shot

pycolmap = require("pycolmap")

_FULL_LENS_FROM = 5  # photos of one camera that pin two focal lengths and four numbers of distortion down
_USUAL_FOCAL = 1.2  # longer sides of the photo, where EXIF states no focal length (COLMAP)
PANORAMA = "EQUIRECTANGULAR"  # COLMAP's camera of 360 x 180 degrees, in which nothing is to be found out


def focal_priors(shots: list[Shot]) -> tuple[dict[CameraKey, float], dict[str, str]]:
    """The focal lengths that EXIF states, pixels by camera; and by photo why one is ignored."""
    by_camera = {shot.camera: shot for shot in shots if not shot.is_panorama}
    priors, ignored = {}, {}
    for camera, shot in by_camera.items():
        guess = _guess(shot)
        if not guess.has_prior_focal_length:
            continue
        focal, reason = usable_prior(camera, by_camera, guess.mean_focal_length())
        if focal is None:
            ignored |= {other.name: reason for other in shots if other.camera == camera}
        else:
            priors[camera] = focal
    return priors, dict(sorted(ignored.items()))


def guess_cameras(shots: list[Shot], priors: Mapping[CameraKey, float]) -> list:
    """A `pycolmap.Camera` for each photo, one for all of one camera, with the prior focal length or a guess."""
    kinds = list(dict.fromkeys(shot.camera for shot in shots))
    cameras = {}
    for number, kind in enumerate(kinds, start=1):
        members = [shot for shot in shots if shot.camera == kind]
        if members[0].is_panorama:
            cameras[kind] = _panorama(number, *members[0].size)
            continue
        focal = priors.get(kind, _USUAL_FOCAL * max(members[0].size))
        model = "OPENCV" if len(members) >= _FULL_LENS_FROM else "SIMPLE_RADIAL"
        camera = pycolmap.Camera.create_from_model_name(number, model, focal, *members[0].size)
        camera.has_prior_focal_length = kind in priors
        cameras[kind] = camera
    return [cameras[shot.camera] for shot in shots]


def _panorama(number: int, width: int, height: int):
    camera = pycolmap.Camera(camera_id=number, model=PANORAMA, width=width, height=height, params=[width, height])
    camera.has_prior_focal_length = True
    return camera


def _guess(shot: Shot):
    """COLMAP's camera of a photo, by its EXIF."""
    with suppress(ValueError):  # Of formats that COLMAP does not read.
        return pycolmap.infer_camera_from_image(shot.path)
    with tempfile.NamedTemporaryFile(suffix=".jpg") as blank, open_image(shot.path) as picture:
        Image.new("L", picture.size).save(blank, "JPEG", exif=tags_of(picture))
        blank.flush()
        return pycolmap.infer_camera_from_image(blank.name)
