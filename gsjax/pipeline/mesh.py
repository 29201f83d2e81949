"""Gaussians to a mesh file."""

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from gsjax import tables
from gsjax.cameras import Camera
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, take, without_view_dependence
from gsjax.io.machine import require_memory
from gsjax.io.scenes import load_scene
from gsjax.io.temporaries import sweep_beside
from gsjax.meshes import Mesh
from gsjax.meshing import boxes, level_set, trimming
from gsjax.meshing.agreed_depth import agreed_poisson
from gsjax.meshing.boxes import Box, Regions, given_numbers
from gsjax.meshing.choosing import Choice, Witness, by_mattes, by_sightlines, most_agreeing
from gsjax.meshing.depth_points import NormalsOfDepth, depth_poisson
from gsjax.meshing.export import supported_suffix, write_mesh
from gsjax.meshing.extract import extract_mesh
from gsjax.meshing.holes import fill_holes
from gsjax.meshing.marching_cubes import marching_cubes
from gsjax.meshing.methods import Method, centers_poisson, level_set_poisson
from gsjax.meshing.outlines import outlines_of
from gsjax.meshing.poisson import PoissonOptions
from gsjax.meshing.settling import settle
from gsjax.meshing.sightlines import sightlines_of
from gsjax.meshing.topology import topology
from gsjax.meshing.tsdf import tsdf
from gsjax.normals.from_depth import smoothed_depth_normals
from gsjax.rendering.floaters import are_floaters
from gsjax.rendering.gallery import Picture
from gsjax.rendering.shown_depths import ShownDepth, coarse_depth
from gsjax.runs.outputs import require_apart
from gsjax.runs.prior import reduction_for
from gsjax.runs.result import Result, open_result, scene_of_run, training_pictures
from gsjax.runs.run import Run
from gsjax.scene import Scene
from gsjax.similarity import Similarity
from gsjax.stereo import depths_of_photos

REACH = 3.0  # standard deviations of a Gaussian, within which it may make surface in a box
MOST_CELLS = 2**16  # along a side; of a surface alone they are tens of gigabytes
BYTES_PER_POINT = 24  # of the surface: place and normal, at the least
AGREED = "agreed"
METHODS = ("poisson", "depth", AGREED, "tsdf", "centers", "marching-cubes")
AUTO, CANDIDATES, USUAL = "auto", METHODS[:-1], "poisson"  # the last where no tracks tell
MOST_COMPARED = 100  # photos, evenly spread: what more of them tell is told already
FEWEST_LINES = 100  # of sight, that tell one method from another


def mesh(
    source: str | Path,
    out: str | Path,
    *,
    method: str = USUAL,
    level: float = 0.3,
    points: int | None = None,
    depth: int | None = None,
    trim_quantile: float | None = None,
    cell: float | None = None,
    bounds: Sequence[float] | None = None,
    background_bounds: Sequence[float] | None = None,
    foreground_only: bool = False,
    faces: int = 1_000_000,
    scene: str | Path | None = None,
    settled: bool = True,
    holes_filled: bool = False,
    keep_floaters: bool = False,
) -> dict[str, Any]:
    """Extract the mesh of a run, or of any file of Gaussians.

    The surface is looked at, and its colours are taken, only where the photos are not masked. Where the training photos
    are at hand it then settles on them (`gsjax.meshing.settling`).

    Args:
        source: Run folder or .ply.
        out: Mesh file; .ply, .obj or .glb.
        method: "poisson" through points of the level set, "depth" through those of the rendered depth, "agreed"
            through those of depth that photos agree about, their own (`gsjax.stereo`) where there are tracks and the
            rendered one where other views confirm it, "tsdf" fusion of the rendered depth, "centers" through the
            Gaussians' centres, "marching-cubes" of the density. "auto": of the first five the one whose mesh agrees
            most with the tracks of structure from motion (`gsjax.meshing.sightlines`), or where there are none with
            the photos' mattes (`gsjax.meshing.outlines`); "poisson" where there is neither, and of a run with an
            entropy phase, which is made for the level set.
        level: Density at which the surface lies ("poisson", "marching-cubes").
        points: Most surface points (the first three). None: an eighth of the pixels, 200,000 to 10 million.
        depth: Of the Poisson octree (those and "centers"). None: chosen from the sizes of the Gaussians.
        trim_quantile: Share of the least supported vertices to cut away (of the same). None: adaptive.
        cell: Side of a voxel ("tsdf") or of a grid cell ("marching-cubes"), scene units. None: from the Gaussians.
        bounds: x0 y0 z0 x1 y1 z1 of the box to keep, scene coordinates. None: around the points; the rest, up to four
            times that size, is a background with a coarser surface of its own.
        background_bounds: The same of a background around `bounds`.
        foreground_only: No background is reconstructed.
        faces: Most triangles of the foreground, and of the background.
        scene: Data set whose cameras to use with a file. None: cameras around the Gaussians, or within them. Of a run
            folder, where its data set is, if it was moved.
        settled: Whether vertices move to where the photos agree.
        holes_filled: Whether holes are closed where the views show a surface (`gsjax.meshing.holes`). After "agreed"
            they always are.
        keep_floaters: Whether Gaussians that hang in the air (`gsjax.rendering.floaters`) take part. They always do
            where no camera of a photo is known.

    Returns:
        A report of plain numbers: `vertices`, `faces`, `method`, what `extract_mesh` says; `floaters`: how many were
        left out, None where nobody looked; `tried`: the shares and seconds of `most_agreeing` for every method that was
        tried to choose one; `settled` and `holes`: what `settle` and `fill_holes` say, or None where it was not done.

    Raises:
        InputError: Nothing to mesh, or a file cannot be read or written.
    """
    supported_suffix(Path(out))
    require_apart(out, source, scene)
    sweep_beside(Path(out))
    _check(level=level, points=points, depth=depth, trim_quantile=trim_quantile, cell=cell, faces=faces)
    given = _given_boxes(bounds, background_bounds, foreground_only)
    result = open_result(source, scene=scene)
    similarity = result.similarity
    kept = tuple(boxes.to_local(box, similarity) for box in given)
    if kept:
        _require_reached(kept, result.gaussians, similarity)
    if cell is not None:
        means = similarity.points_to_world(np.asarray(result.gaussians.means))
        _check_cell(cell, means if bounds is None else np.reshape(bounds, (2, 3)))
        cell = similarity.length_to_local(cell)
    data = _data_set(Path(source), scene) if settled or method in (AUTO, AGREED) else None
    floaters = None
    if not keep_floaters and (scene is not None or Path(source).is_dir()):
        result, floaters = _without_floaters(result)
    views = _Views(result, data)

    def extract(name: str) -> tuple[Mesh, dict]:
        cameras, pictures = _pictures(result)
        return extract_mesh(
            result.gaussians,
            cameras,
            pictures,
            method=_method(name, views, level, points, depth, trim_quantile, cell),
            regions=_regions(kept, foreground_only),
            max_faces=faces,
            similarity=similarity,
        )

    choice = (
        _chosen(extract, Path(source), data, kept) if method == AUTO else Choice(method, *extract(method), tried={})
    )
    surface, report = choice.mesh, choice.report
    if holes_filled or choice.method == AGREED:
        surface, closed = fill_holes(surface, views.shown)
        report |= {"holes": asdict(closed), "topology": asdict(topology(surface))}
    if settled and data is not None:
        surface, report["settled"] = settle(surface, data.train_frames)
    write_mesh(out, similarity.mesh_to_world(surface), result.place)
    sizes = {"vertices": len(surface.vertices), "faces": len(surface.faces), "floaters": floaters}
    return {**sizes, "method": choice.method, "tried": choice.tried, "settled": None, "holes": None, **report}


class _Views:
    """What the training views tell, each looked for once, and only if a method asks."""

    def __init__(self, result: Result, data: Scene | None):
        self.result, self.data = result, data

    @cached_property
    def shown(self) -> list[ShownDepth]:
        """What every view shows, coarse."""
        return list(map(coarse_depth, *_pictures(self.result, with_owners=False)))

    @cached_property
    def told(self) -> dict[int, ShownDepth]:
        """By the view's place, the depth that its photo tells."""
        if self.data is None:
            return {}
        every = zip(self.result.names, self.result.held_out, strict=True)
        names = [name for name, held_out in every if not held_out]
        depths = depths_of_photos(self.data, MOST_COMPARED)
        print(f"mesh: depth that photos agree about: {depths.line}", file=sys.stderr)
        return {names.index(each.view.name): each.shown() for each in depths.told}

    @cached_property
    def normals_of(self) -> NormalsOfDepth:
        """Normals of depth in windows as large as the run's noise asks for."""
        cameras, _ = _pictures(self.result)
        reduction = reduction_for(self.result.gaussians, cameras, self.result.depth_mode)
        return partial(smoothed_depth_normals, reduction=reduction)


def _without_floaters(result: Result) -> tuple[Result, int]:
    """The same without the Gaussians that hang in the air, and how many those were."""
    cameras, pictures = _pictures(result, with_owners=False)
    hang = are_floaters(result.gaussians, map(coarse_depth, cameras, pictures))
    return replace(result, gaussians=take(result.gaussians, ~hang)), int(hang.sum())


def _pictures(result: Result, *, with_owners: bool = True) -> tuple[list[Camera], Iterator[Picture]]:
    """What every method looks at: the Gaussians in their constant colour, from the training views."""
    plain = without_view_dependence(result.gaussians)
    return training_pictures(result, plain, result.background, with_owners=with_owners)


def _data_set(source: Path, scene: str | Path | None) -> Scene | None:
    """The data set of a run, or `scene`; None, and one line, where a run's photos have gone."""
    if not source.is_dir():
        return None if scene is None else load_scene(scene)
    if scene is not None:
        return scene_of_run(source, scene=scene)
    try:
        return scene_of_run(source)
    except InputError as error:
        print(f"mesh: goes on without its photos: {error}", file=sys.stderr)
        return None


def _chosen(
    extract: Callable[[str], tuple[Mesh, dict]], source: Path, data: Scene | None, kept: Sequence[Box]
) -> Choice:
    """The method that agrees most with what the data set knows, of what lies in the boxes where any are given."""
    witness = None if data is None or _made_for_the_level_set(source) else _witness(data, kept)
    if witness is None:
        return Choice(USUAL, *extract(USUAL), tried={})
    choice = most_agreeing({name: partial(extract, name) for name in CANDIDATES}, witness)
    print(f"mesh: {choice.method}, by {witness.says}", file=sys.stderr)
    print(tables.compare(choice.tried), file=sys.stderr)
    return choice


def _witness(data: Scene, kept: Sequence[Box]) -> Witness | None:
    """The tracks, where they are enough; else the mattes, which show the whole object and nothing of a box."""
    lines = sightlines_of(data)
    if kept:
        lines = lines.within(kept)
    if len(lines) >= FEWEST_LINES:
        return by_sightlines(lines)
    outlines = () if kept else outlines_of(data)
    return by_mattes(outlines) if outlines else None


def _made_for_the_level_set(source: Path) -> bool:
    """Whether this is a run with an entropy phase, which leaves Gaussians that are opaque or nothing (SuGaR)."""
    return source.is_dir() and any("entropy" in phase["terms"] for phase in Run(source).plan["phases"])


def _method(
    name: str,
    views: _Views,
    level: float,
    points: int | None,
    depth: int | None,
    trim_quantile: float | None,
    cell: float | None,
) -> Method:
    trim = trimming.adaptive if trim_quantile is None else trimming.at_quantile(trim_quantile)
    reconstruction = PoissonOptions(depth=depth, trim=trim)
    sampling = replace(level_set.options_for(views.result.cameras), level=level)
    if points is not None:
        sampling = replace(sampling, num_points=points)
    makers = {
        "poisson": partial(level_set_poisson, sampling, reconstruction),
        "depth": lambda: depth_poisson(views.normals_of, sampling.num_points, reconstruction),
        AGREED: lambda: agreed_poisson(
            views.normals_of, sampling.num_points, reconstruction, shown=views.shown, told=views.told
        ),
        "tsdf": partial(tsdf, voxel=cell),
        "centers": partial(centers_poisson, reconstruction),
        "marching-cubes": partial(marching_cubes, level=level, cell=cell),
    }
    if name not in makers:
        raise InputError(f"--method {name} is none of {', '.join((AUTO, *METHODS))}")
    return makers[name]()


def _given_boxes(
    bounds: Sequence[float] | None, background: Sequence[float] | None, foreground_only: bool
) -> tuple[Box, ...]:
    """The boxes of the foreground and of the background that the options ask for, in the world; none: any."""
    if bounds is None:
        if background is not None:
            raise InputError("--background-bounds needs --bounds: the background is what lies around that box")
        return ()
    near = _given_box("--bounds", bounds)
    far = None if background is None else _given_box("--background-bounds", background)
    return (near,) if foreground_only or far is None else (near, far)


def _given_box(option: str, corners: Sequence[float]) -> Box:
    sides = given_numbers(option, corners, 6)
    if not np.isfinite(sides).all():
        raise InputError(f"{option} {' '.join(f'{side:g}' for side in sides)}: not all of its sides are finite")
    return Box(sides[:3], sides[3:])


def _require_reached(kept: tuple[Box, ...], gaussians: Gaussians, similarity: Similarity) -> None:
    """Before views are drawn: raises InputError where no Gaussian reaches into any of the boxes, local coordinates."""
    means = np.asarray(gaussians.means)
    reach = REACH * np.exp(np.asarray(gaussians.log_scales)).max(axis=1)
    if any((box.distances(means) <= reach).any() for box in kept):
        return
    low, high = (similarity.points_to_world(end(means, axis=0)).round(3).tolist() for end in (np.min, np.max))
    corners = similarity.points_to_world(np.stack([kept[-1].low, kept[-1].high])).round(3).tolist()
    raise InputError(
        f"--bounds: the box {corners[0]} to {corners[1]} holds none of {len(means)} Gaussians, "
        f"which span {low} to {high}"
    )


def _regions(kept: tuple[Box, ...], foreground_only: bool) -> Callable[[np.ndarray], Regions]:
    """From points to regions: the boxes, or what the points ask for where there are none."""
    if kept:
        return lambda _: boxes.fixed_boxes(*kept)
    return boxes.near_only if foreground_only else boxes.near_and_far


def _check_cell(cell: float, places: np.ndarray) -> None:
    """Before views are drawn. What a grid really takes is looked at again once its box is known."""
    low, high = np.quantile(places, [0.01, 0.99], axis=0)
    along = float((high - low).max()) / cell if len(places) else 0
    if along > MOST_CELLS:
        raise InputError(
            f"--cell {cell:g}: makes {along:,.0f} cells along the scene's longest side, above {MOST_CELLS:,}"
        )


def _check(*, level, points, depth, trim_quantile, cell, faces) -> None:
    if not 0 < level < 1:
        raise InputError(f"--level {level} is not between 0 and 1")
    if trim_quantile is not None and not 0 <= trim_quantile < 1:
        raise InputError(f"--trim-quantile {trim_quantile} is not in 0..1")
    if points is not None:
        if points < 1:
            raise InputError(f"--points {points} is below 1")
        require_memory(f"--points {points}", BYTES_PER_POINT * points)
    if depth is not None and not 2 <= depth <= 14:
        raise InputError(f"--depth {depth} is not between 2 and 14")
    if cell is not None and not 0 < cell < math.inf:
        raise InputError(f"--cell {cell} is not a number above 0")
    if faces < 1:
        raise InputError(f"--faces {faces} is below 1")
