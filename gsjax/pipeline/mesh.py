"""Gaussians to a mesh file."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io.scenes import load_scene
from gsjax.io.temporary_files import sweep_beside
from gsjax.meshing import holes, level_set
from gsjax.meshing.connectivity import topology
from gsjax.meshing.export import supported_suffix, write_mesh
from gsjax.meshing.extract import extract_mesh
from gsjax.meshing.mesh_method import Method
from gsjax.meshing.methods import AUTO, USUAL, MeshMethod, MethodOptions, methods_of
from gsjax.meshing.photo_refine import refine_on_photos
from gsjax.meshing.regions import Crop, crop_of
from gsjax.meshing.select_method import evidence_of, select_method
from gsjax.pipeline.mesh_views import MeshViews
from gsjax.report import tables
from gsjax.runs.outputs import require_apart
from gsjax.runs.result import Result, open_result, scene_of_run
from gsjax.runs.run import Run
from gsjax.scene import Scene
from gsjax.scene.meshes import Mesh

FEWEST_TRIED = 20  # views, where there are as many, by which `auto` judges a method


@dataclass(frozen=True)
class Request:
    """What surface is requested, whatever the method."""

    options: MethodOptions
    crop: Crop
    faces: int  # at most, of a region

    def __post_init__(self):
        if self.faces < 1:
            raise InputError(f"faces={self.faces} is below 1")


def mesh(
    source: str | Path,
    out: str | Path,
    *,
    method: str | Method = AUTO,
    level: float | None = None,
    points: int | None = None,
    depth: int | None = None,
    trim_quantile: float | None = None,
    cell: float | None = None,
    bounds: Sequence[float] | None = None,
    background_bounds: Sequence[float] | None = None,
    foreground_only: bool = False,
    faces: int = 1_000_000,
    scene: str | Path | None = None,
    photo_refine: bool = True,
    fill_holes: bool = False,
    keep_floaters: bool = False,
) -> dict[str, Any]:
    """Extract the mesh of a run, or of any file of Gaussians.

    The surface is seen, and its colours are taken, only where the photos are not masked. Where the training photos
    exist its vertices are then refined on them (`gsjax.meshing.photo_refine`).

    Args:
        source: Run folder or .ply.
        out: Mesh file; .ply, .obj or .glb.
        method: A name in `gsjax.meshing.methods.METHODS`; or a function, as `gsjax.extract_mesh` takes it. Its
            pictures have owners. "auto": of the methods that read the given options, the one whose mesh fits best
            to the tracks of structure from motion (`gsjax.meshing.track_visibility`), or without tracks with the
            photos' mattes (`gsjax.meshing.silhouettes`); "poisson" where there is neither, and of a run with an entropy
            phase, which is made for the level set.
        level: Density at which the surface is ("poisson"). None: 0.3.
        points: Most surface points ("poisson"). None: an eighth of the pixels, 200,000 to 10 million.
        depth: Of the Poisson octree (the same). None: chosen from the sizes of the Gaussians.
        trim_quantile: Share of the least supported vertices to cut away (the same). None: adaptive.
        cell: Side of a voxel ("tsdf"), scene units. None: from the Gaussians.
        bounds: x0 y0 z0 x1 y1 z1 of the box to keep, scene coordinates. None: around the points; the rest, up to four
            times that size, is a background with a coarser surface of its own.
        background_bounds: The same of a background around `bounds`.
        foreground_only: No background is reconstructed.
        faces: Most triangles of the foreground, and of the background.
        scene: Data set whose cameras to use with a file. None: cameras around the Gaussians, or within them. Of a run
            folder, where its data set is, if it was moved.
        photo_refine: Whether vertices are refined on the photos.
        fill_holes: Whether holes are closed where the views show a surface (`gsjax.meshing.holes`).
        keep_floaters: Whether Gaussians that hang in the air (`gsjax.rendering.outliers`) take part. They always do
            where no camera of a photo is known.

    Returns:
        A report: `vertices`, `faces`, the name of the `method`, what `extract_mesh` reports; `floaters`: how many were
        left out, None where they were not searched; `tried`: the shares and seconds of every method that `auto` tried;
        `photo_refine` and `holes`: what `refine_on_photos` and `fill_holes` report, or None where it was not done.

    Raises:
        InputError: Nothing to mesh, an option that the method does not read or that is out of range, or a file cannot
            be read or written.
    """
    supported_suffix(Path(out))
    require_apart(out, source, scene)
    sweep_beside(Path(out))
    options = MethodOptions(level, points, depth, trim_quantile, cell)
    methods = methods_of(method, options)
    request = Request(options, crop_of(bounds, background_bounds, foreground_only), faces)
    needs = frozenset[str]().union(*(each.needs for each in methods.values()))
    result, data = _open(Path(source), scene, with_photos=photo_refine or len(methods) > 1 or "photos" in needs)
    request = _to_local(request, result)
    views, floaters = MeshViews(result, data, with_owners="owners" in needs), None
    if not keep_floaters and (scene is not None or Path(source).is_dir()):
        views, floaters = views.without_floaters()
    surface, report = _extract_best(methods, request, views)
    report |= {"floaters": floaters, "holes": None, "photo_refine": None}
    if fill_holes:
        surface, closed = holes.fill_holes(surface, views.rendered)
        report |= {"holes": closed, "topology": topology(surface)}
    if photo_refine and data is not None:
        surface, report["photo_refine"] = refine_on_photos(surface, data.train_frames)
    write_mesh(out, result.similarity.mesh_to_world(surface), result.place)
    return {"vertices": len(surface.vertices), "faces": len(surface.faces), **report}


def _open(source: Path, scene: str | Path | None, *, with_photos: bool) -> tuple[Result, Scene | None]:
    """Return the result and its data set; None, and one line, where a run's photos have gone."""
    result = open_result(source, scene=scene)
    if not with_photos or (scene is None and not source.is_dir()):
        return result, None
    if scene is not None:
        return result, scene_of_run(source, scene=scene) if source.is_dir() else load_scene(scene)
    try:
        return result, scene_of_run(source)
    except InputError as error:
        print(f"mesh: continues without its photos: {error}", file=sys.stderr)
        return result, None


def _to_local(request: Request, result: Result) -> Request:
    """Return the request in the coordinates of the result, with a number of points; checked before views are drawn."""
    similarity, boxes = result.similarity, request.crop.boxes
    corners = [corner for box in boxes[:1] for corner in (box.low, box.high)]
    extent = np.array(corners) if corners else similarity.points_to_world(np.asarray(result.gaussians.means))
    options, crop = request.options.to_local(similarity, extent), request.crop.to_local(similarity)
    crop.require_reached(result.gaussians, similarity)
    if options.points is None:
        options = replace(options, points=level_set.points_for(result.cameras))
    return replace(request, options=options, crop=crop)


def _extract_best(methods: Mapping[str, MeshMethod], request: Request, views: MeshViews) -> tuple[Mesh, dict[str, Any]]:
    """Return the mesh by the method that is selected, and the report of it and of those that were tried."""
    name, judgements = _select(methods, request, views)
    surface, report = _extract(methods[name], request, views, views.ids)
    return surface, report | {"method": name, "tried": judgements}


def _select(methods: Mapping[str, MeshMethod], request: Request, views: MeshViews) -> tuple[str, dict[str, dict]]:
    """Return the only method; of several, that which fits best to the data set, or the usual one without it.

    They are judged by meshes of a tenth of the views and of the points.
    """
    if len(methods) == 1:
        return next(iter(methods)), {}
    is_judged = views.data is not None and not _made_for_the_level_set(views.result.source)
    witness = evidence_of(views.data, request.crop.boxes) if is_judged else None
    if witness is None:
        return USUAL, {}
    ids = views.spread(max(len(views.ids) // 10, FEWEST_TRIED))
    extract = partial(_extract, request=replace(request, options=request.options.for_comparison), views=views, ids=ids)
    name, judgements = select_method({name: lambda m=m: extract(m)[0] for name, m in methods.items()}, witness)
    print(f"mesh: {name}, by {witness.says}", file=sys.stderr)
    print(tables.compare(judgements), file=sys.stderr)
    return name, judgements


def _made_for_the_level_set(source: Path) -> bool:
    """Whether this is a run with an entropy phase, which leaves Gaussians that are opaque or nothing (SuGaR)."""
    return source.is_dir() and any("entropy" in phase["terms"] for phase in Run(source).plan["phases"])


def _extract(method: MeshMethod, request: Request, views: MeshViews, ids: Sequence[int]) -> tuple[Mesh, dict[str, Any]]:
    """Return the mesh by one method from the views of some indices, and the report of `extract_mesh`."""
    return extract_mesh(
        views.result.gaussians,
        [views.cameras[index] for index in ids],
        views.pictures(ids),
        method=method.make(request.options, views, ids),
        regions=request.crop.regions,
        max_faces=request.faces,
        similarity=views.result.similarity,
    )
