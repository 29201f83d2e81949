"""Pictures of a few views of a run, small enough for its report: RUN/pictures/0007_photo.jpg and the like."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsjax import runs
from gsjax.effects.sky import Masks, tinted
from gsjax.io.files import atomic_path
from gsjax.io.images import jpeg_bytes, resize
from gsjax.meshing.export import read_mesh
from gsjax.meshing.pictures import headlight, vertex_colors
from gsjax.meshing.ray_queries import ray_caster
from gsjax.rendering.gallery import Picture
from gsjax.report.pictures import mesh_picture, surface_picture
from gsjax.runs.records import read_views
from gsjax.runs.result import frame_camera, recorded_camera
from gsjax.runs.viewpoints import evenly_spread
from gsjax.scene import Frame
from gsjax.scene.cameras import Camera
from gsjax.scene.colors import to_bytes

FOLDER = "pictures"
KINDS = ("photo", "render", "normals")
SKY = "sky"  # kept beside those where the run knows of one
MOST_VIEWS, LONGEST_SIDE = 6, 560  # a page of them stays under 4 MB


def report_views(records: Sequence[dict[str, Any]]) -> list[int]:
    """Which views of `cameras.json` a report shows: held-out ones, evenly spread; of none, any."""
    held_out = [index for index, record in enumerate(records) if record["held_out"]]
    some = held_out or range(len(records))
    return [some[place] for place in evenly_spread(len(some), MOST_VIEWS)]


def picture_keeper(run: Path) -> Callable[[Frame, np.ndarray, Picture], None]:
    """An observer of the scored frames of a run with its `cameras.json`; it stores pictures of those in the report."""
    records = read_views(run)
    places = {records[index]["name"]: index for index in report_views(records)}

    def keep(frame: Frame, target: np.ndarray, picture: Picture) -> None:
        if frame.name not in places:
            return
        normals = surface_picture(picture.depth, frame_camera(frame))
        for kind, image in zip(KINDS, (to_bytes(target), to_bytes(picture.colors), normals), strict=True):
            _keep(run, places[frame.name], kind, image)

    return keep


def keep_skies(run: Path, frames: Sequence[Frame], skies: Masks) -> None:
    """Keeps the photos of those views that the report shows with their sky in magenta; none where there is no sky.

    The frames are in the order of `cameras.json`.
    """
    for index in report_views(read_views(run)) if skies else ():
        frame = frames[index]
        _keep(run, index, SKY, tinted(frame.pixels().image, skies.get(frame.name)))


def stored_pictures(run: Path, index: int) -> dict[str, bytes]:
    """The JPEGs that were kept of a view, by kind; those that there are."""
    files = {kind: _file(run, index, kind) for kind in (*KINDS, SKY)}
    return {kind: file.read_bytes() for kind, file in files.items() if file.exists()}


def mesh_pictures(run: Path, records: Sequence[dict[str, Any]]) -> list[dict[str, bytes]]:
    """JPEGs of `RUN/mesh.ply` from each of these views, its shape and its colours; empty ones without a mesh."""
    if not (run / "mesh.ply").exists():
        return [{} for _ in records]
    similarity = runs.read_similarity(run)
    mesh = similarity.mesh_to_local(read_mesh(run / "mesh.ply"))
    cast = ray_caster(mesh)

    def pictures_of(record: dict[str, Any]) -> dict[str, bytes]:
        camera = _small_camera(recorded_camera(record, similarity))
        shadings = {"mesh": headlight, "mesh colours": vertex_colors}
        return {kind: jpeg_bytes(mesh_picture(mesh, camera, shading, cast)) for kind, shading in shadings.items()}

    return [pictures_of(record) for record in records]


def _keep(run: Path, index: int, kind: str, image: np.ndarray) -> None:
    height, width = image.shape[:2]
    with atomic_path(_file(run, index, kind)) as temporary:
        temporary.write_bytes(jpeg_bytes(resize(image, *_reduced(width, height))))


def _file(run: Path, index: int, kind: str) -> Path:
    return run / FOLDER / f"{index:04d}_{kind}.jpg"


def _reduced(width: int, height: int) -> tuple[int, int]:
    factor = max(1.0, max(width, height) / LONGEST_SIDE)
    return round(width / factor), round(height / factor)


def _small_camera(camera: Camera) -> Camera:
    width, height = _reduced(camera.width, camera.height)
    scale = np.array([[width / camera.width], [height / camera.height], [1.0]])
    return Camera(camera.viewmat, scale * np.asarray(camera.K), width, height)
