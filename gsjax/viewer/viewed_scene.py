"""The content of a page: a run, a file of Gaussians, or a mesh, with the cameras and photos that belong to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.io.gaussian_files import FORMATS
from gsjax.meshing.export import SUFFIXES, is_mesh_file, read_mesh
from gsjax.rendering import DepthReading
from gsjax.runs.result import BACKGROUND_COLORS, Result, frame_camera, open_result, scene_of_run
from gsjax.runs.viewpoints import mean_up, opaque_middle
from gsjax.scene import Frame, Scene
from gsjax.scene.cameras import Camera, look_at, viewmat_center
from gsjax.scene.similarity import IDENTITY, Similarity, of_points


@dataclass(frozen=True)
class ViewedScene:
    """What a page shows."""

    name: str
    start: Camera  # where the page looks from at first
    middle: np.ndarray  # [3] world: what it turns around
    up: np.ndarray  # [3] unit, world
    scale: float  # scene units: how far the start is from the middle
    gaussians: Gaussians | None = None  # numpy; None where there are none, or not yet
    cameras: Mapping[str, Camera] = field(default_factory=dict)  # by the names of their photos
    photos: Mapping[str, Frame] = field(default_factory=dict)  # those that are at hand
    mesh: Path | None = None
    # [3] or SH, see `gsjax.rendering.backdrop`
    background: np.ndarray = field(default_factory=lambda: BACKGROUND_COLORS["black"])
    depth_mode: DepthReading = "plane"
    similarity: Similarity = IDENTITY  # to all of this, which is local, from the mesh in its file


def open_viewed_scene(
    source: str | Path, *, mesh: str | Path | None = None, notify: Callable[[str], None] = lambda _: None
) -> ViewedScene:
    """Reads a run folder, a file of Gaussians or a mesh; the header of a .ply decides.

    With Gaussians a mesh is shown: the given one, else `mesh.ply` of a run that has one. `notify` receives a line where
    the photos of a run do not exist.

    Raises:
        InputError: It is none of these, or cannot be read.
    """
    source = Path(source)
    if not source.exists():
        raise InputError(f"{source}: no such file or folder")
    if mesh is not None:
        read_mesh(mesh)
    is_folder = source.is_dir()
    if not is_folder and is_mesh_file(source):
        if mesh is not None:
            raise InputError(f"{source}: is a mesh itself; a second mesh goes with Gaussians")
        return _of_mesh(source)
    if not is_folder and not source.name.lower().endswith(tuple(FORMATS)):
        suffixes = ", ".join(FORMATS), ", ".join(SUFFIXES)
        raise InputError(
            f"{source}: is no run folder, and no file of Gaussians ({suffixes[0]}) or of a mesh ({suffixes[1]})"
        )
    result = open_result(source)
    if not result.gaussians.num_gaussians:
        raise InputError(f"{source}: holds no Gaussians, there is nothing to show")
    viewed = ViewedScene(
        source.resolve().name if is_folder else source.name,
        **_seen_from(list(result.cameras), opaque_middle(result.gaussians)),
        gaussians=result.gaussians,
        mesh=Path(mesh) if mesh else None,
        background=result.background,
        depth_mode=result.depth_mode,
        similarity=result.similarity,
    )
    return _with_parts_of_run(viewed, source, result, notify) if is_folder else viewed


def _with_parts_of_run(viewed: ViewedScene, run: Path, result: Result, notify: Callable[[str], None]) -> ViewedScene:
    """With the cameras of a run, its photos, and its mesh where there is no other."""
    own_mesh = run / "mesh.ply"
    if viewed.mesh is None and own_mesh.exists():
        read_mesh(own_mesh)
        viewed = replace(viewed, mesh=own_mesh)
    try:
        photos = {frame.name: frame for frame in scene_of_run(run).frames}
    except InputError as error:
        notify(f"no photos: {error}")
        photos = {}
    return replace(viewed, cameras=dict(zip(result.names, result.cameras, strict=True)), photos=photos)


def view_data_set(name: str, scene: Scene, background: str, depth_mode: DepthReading) -> ViewedScene:
    """A data set of which Gaussians are yet to come."""
    cameras = {frame.name: frame_camera(frame) for frame in scene.frames}
    middle = np.median(scene.points, axis=0) if len(scene.points) else np.zeros(3)
    return ViewedScene(
        name,
        **_seen_from(list(cameras.values()), middle),
        cameras=cameras,
        photos={frame.name: frame for frame in scene.frames},
        background=BACKGROUND_COLORS[background],
        depth_mode=depth_mode,
    )


def _of_mesh(path: Path) -> ViewedScene:
    """A mesh that is on z, from a side and from above."""
    mesh = read_mesh(path)
    similarity = of_points(mesh.vertices)
    mesh = similarity.mesh_to_local(mesh)
    low, high = np.quantile(mesh.vertices[np.unique(mesh.faces)].astype(np.float64), [0.01, 0.99], axis=0)
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-12)
    up, K = np.array([0.0, 0.0, 1.0]), np.array([[600.0, 0, 400], [0, 600.0, 300], [0, 0, 1]], np.float32)
    eye = middle + radius * np.array([2.2, 1.2, 1.0])
    seen_from = _seen_from([Camera(look_at(eye, middle, up), K, 800, 600)], middle)
    return ViewedScene(path.name, **{**seen_from, "up": up}, mesh=path, similarity=similarity)


def _seen_from(cameras: list[Camera], middle: np.ndarray) -> dict:
    """Where a page begins: at the first camera."""
    eye = viewmat_center(np.asarray(cameras[0].viewmat, np.float64))
    return {
        "start": cameras[0],
        "middle": np.asarray(middle, np.float64),
        "up": mean_up(cameras),
        "scale": float(np.linalg.norm(eye - middle)) or 1.0,
    }
