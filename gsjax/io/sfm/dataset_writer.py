"""A model in the sensor's frame to a data set of upright, undistorted photos."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.io.colmap_writer import write_whole
from gsjax.io.images import filter_straight, write_image
from gsjax.io.lenses import Lens, PinholeView, pinhole_views
from gsjax.io.packages import require
from gsjax.io.parallel_map import Progress
from gsjax.io.photo_names import printable_name, written_name
from gsjax.io.photos import valid_of
from gsjax.io.sfm.initial_cameras import panorama_camera
from gsjax.io.sfm.source_photos import SourcePhoto, turned_pinhole, turned_points, turned_pose

pycolmap = require("pycolmap")


def write_dataset(model: Any, photos: Sequence[SourcePhoto], folder: Path, progress: Progress) -> None:
    """Write `images/` and `sparse/0` (PINHOLE), the layout that 3DGS programs read; panoramas stay whole.

    Mattes become the alpha of PNGs; masks, and pixels that the undistorted photo does not cover, `masks/`. The model is
    a `pycolmap.Reconstruction` in the sensors' frames; its image ids count the photos from 1.
    """
    upright = pycolmap.Reconstruction()
    names: set[str] = set()
    cameras: dict[tuple[int, int], int] = {}  # ids, by id of the camera in the model and quarter turns
    sums = {point: np.zeros(4) for point in model.points3D}  # colours that were seen of a point, and how many
    # Camera by camera: the map of a lens is large and made once.
    images = sorted(model.reg_image_ids(), key=lambda image: (model.image(image).camera_id, image))
    with progress(total=len(images), desc="undistortion", unit="photo") as bar:
        for number in images:
            image, photo = model.image(number), photos[number - 1]
            view = _whole(image.camera) if photo.is_panorama else pinhole_views(_lens(image.camera))[0]
            key = (image.camera_id, photo.to_upright)
            if key not in cameras:
                cameras[key] = len(cameras) + 1
                upright.add_camera_with_trivial_rig(_upright_camera(cameras[key], view, photo))
            colors, matte = photo.read()
            if view.source_xy is not None:
                colors, matte = filter_straight(colors, matte, view.warp)
            name = written_name(photo.name, matte is not None)
            if name in names:  # Of another photo: all of the listed name tells them apart.
                name = f"{printable_name(photo.name)}{Path(name).suffix}"
            names.add(name)
            xy = _keypoints(image) if photo.is_panorama else _undistorted(image, view)
            _gather_colors(sums, image, colors, xy)
            _write_pictures(folder, name, photo, view, colors if matte is None else np.dstack([colors, matte]))
            xy = turned_points(xy, view.width, view.height, photo.to_upright)
            pose = turned_pose(image.cam_from_world().matrix(), photo.to_upright)
            turned = pycolmap.Image(name, xy, cameras[key], number)
            upright.add_image_with_trivial_frame(turned, pycolmap.Rigid3d(pose))
            bar.update(1)
    for number, point in model.points3D.items():
        color = np.rint(sums[number][:3] / max(sums[number][3], 1)).astype(np.uint8)
        upright.add_point3D(point.xyz, point.track, color)
    upright.update_point_3d_errors()
    write_whole(upright, folder / "sparse" / "0")


def _write_pictures(folder: Path, name: str, photo: SourcePhoto, view: PinholeView, picture: np.ndarray) -> None:
    """Write an image, and its mask where one of its pixels is not valid."""
    write_image(folder / "images" / name, photo.upright(picture))
    valid = valid_of(view, photo.read_mask(), view.width, view.height)
    if valid is not None and not valid.all():
        write_image(folder / "masks" / f"{name}.png", photo.upright(valid))


def _lens(camera) -> Lens:
    return Lens(camera.model_name, camera.width, camera.height, tuple(camera.params))


def _upright_camera(number: int, view: PinholeView, photo: SourcePhoto):
    if photo.is_panorama:
        return panorama_camera(number, view.width, view.height)
    params, width, height = turned_pinhole(view.K, view.width, view.height, photo.to_upright)
    return pycolmap.Camera(camera_id=number, model="PINHOLE", width=width, height=height, params=params)


def _whole(camera) -> PinholeView:
    """A panorama as it is: it is no pinhole view, so there is no K."""
    return PinholeView("", np.eye(3), np.full((3, 3), np.nan), camera.width, camera.height, None, None)


def _keypoints(image) -> np.ndarray:
    return np.array([point.xy for point in image.points2D]).reshape(-1, 2)


def _undistorted(image, view: PinholeView) -> np.ndarray:
    """`[N, 2]` pixels of the view where the photo's features are."""
    return image.camera.cam_from_img(_keypoints(image)) * view.K[[0, 1], [0, 1]] + view.K[:2, 2]


def _gather_colors(sums: dict[int, np.ndarray], image, colors: np.ndarray, xy: np.ndarray) -> None:
    height, width = colors.shape[:2]
    for point, (x, y) in zip(image.points2D, xy, strict=True):
        if point.has_point3D() and 0 <= x < width and 0 <= y < height:
            sums[point.point3D_id] += [*colors[int(y), int(x)], 1]
