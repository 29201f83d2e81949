"""Poisson through depth that views agree about: what one view alone shows makes no surface.

Gaussians fit every photo, also with depth that is wrong: where nothing has texture, and where few photos look, each
view shows a surface of its own, and all of them together are lumps and shells. Photos compared with each other
(`gsjax.stereo`) have depth without Gaussians, but not everywhere.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from gsjax.errors import NoSurfaceError
from gsjax.gaussians import Gaussians
from gsjax.meshing import level_set
from gsjax.meshing.mesh_method import Method, SurfaceSamples, poisson_through
from gsjax.meshing.poisson import PoissonOptions
from gsjax.rendering.coarse_depths import CoarseDepth, depths_at
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera, viewmat_center
from gsjax.scene.colors import to_bytes

NormalsOfDepth = Callable[[np.ndarray, np.ndarray, Camera], np.ndarray]
"""Depth and alphas `[H, W]`, camera -> `[H, W, 3]` unit normals in its frame, towards it; zero where there is none."""

LEAST_FACING = 0.15  # Cosine between normal and ray: what is seen at a flatter angle is an edge, or off by much.
AGREEING = 2  # Other views, at the least, that show a surface where a view shows it: one may be wrong as well.
SHARE = 0.7  # Of the views that observe the place, those that show it; the others see through it.
SAME_SURFACE = 0.005  # Share of the depth up to which two views show one surface.
FROM_ELSEWHERE = np.cos(np.radians(4.0))  # Cosine between two rays to a point: views nearer together are no evidence.
MOST_OTHERS = 16  # Views that are compared, those that observe most of what a view shows.
SAMPLED = 200  # Points of a view by which these are chosen.


def consistent_poisson(
    normals_of: NormalsOfDepth,
    num_points: int,
    reconstruction: PoissonOptions | None = None,
    *,
    rendered: Sequence[CoarseDepth],
    stereo: Mapping[int, CoarseDepth],
    ids: Sequence[int] | None = None,
) -> Method:
    """`depth_poisson` of `consistent_pictures`; the arguments are those of both."""
    of_depth = depth_poisson(normals_of, num_points, reconstruction)

    def from_consistent_depth(
        gaussians: Gaussians, cameras: Sequence[Camera], pictures: Iterable[Picture]
    ) -> SurfaceSamples:
        shares: list[float] = []

        def counted() -> Iterator[Picture]:
            for picture in consistent_pictures(cameras, pictures, rendered, stereo, ids):
                shares.append(float((picture.depth > 0).mean()))
                yield picture

        sighting = of_depth(gaussians, cameras, counted())
        of_stereo = {"photos_that_tell": len(stereo), "agreed_share": float(np.mean(shares))}
        return sighting._replace(report=sighting.report | of_stereo)

    return from_consistent_depth


def consistent_pictures(
    cameras: Sequence[Camera],
    pictures: Iterable[Picture],
    rendered: Sequence[CoarseDepth],
    stereo: Mapping[int, CoarseDepth],
    ids: Sequence[int] | None = None,
) -> Iterator[Picture]:
    """The same pictures, with depth where views agree about it and nothing elsewhere.

    Stereo depth of a photo replaces the rendered one, and the pixel counts as covered. Rendered depth
    stays where at least `AGREEING` other views, and `SHARE` of those that nothing nearer hides it from, show a surface
    at the same place, up to `SAME_SURFACE` of the depth.

    Args:
        cameras: One camera a view.
        pictures: One rendered picture a camera, in order; read one by one.
        rendered: The coarse rendered depth of all views, which confirm each other.
        stereo: By the view's index in `rendered`, the stereo depth of its photo, of any size; 0 where it has none.
        ids: Of every camera, its index in `rendered`. None: the cameras are those of all views.
    """
    mixed = [_mixed(view, stereo.get(index)) for index, view in enumerate(rendered)]
    asked = _others(mixed)
    ids = range(len(rendered)) if ids is None else ids
    for index, camera, picture in zip(ids, cameras, pictures, strict=True):
        level_set.check_sizes(index, camera, picture)
        agreed = _agreed(mixed[index], [mixed[other] for other in asked[index]])
        depth = np.where(_enlarged(agreed, camera), picture.depth, 0).astype(np.float32)
        covered = np.asarray(picture.alphas)
        if index in stereo:
            by_photos = _enlarged(stereo[index].depth, camera)
            depth = np.where(by_photos > 0, by_photos, depth)
            covered = np.where(by_photos > 0, np.float32(1), covered)
        yield picture._replace(depth=depth, alphas=covered)


def _mixed(rendered: CoarseDepth, stereo: CoarseDepth | None) -> CoarseDepth:
    """The coarse view, with stereo depth where its photo has some."""
    if stereo is None:
        return rendered
    by_photo = _enlarged(stereo.depth, rendered.camera)
    return rendered._replace(depth=np.where(by_photo > 0, by_photo, rendered.depth))


def _agreed(view: CoarseDepth, others: Sequence[CoarseDepth]) -> np.ndarray:
    """`[H, W]` bool: where enough of the others show a surface at the place that the view shows."""
    rows, columns = np.nonzero(view.depth)
    points, rays = level_set.world_points(view.camera, view.depth, rows, columns)
    agreeing, looking = np.zeros((2, len(points)), np.int32)
    for other in others:
        depths, there = depths_at(points, other)
        towards = points - viewmat_center(np.asarray(other.camera.viewmat, np.float64))
        cosine = np.sum(rays * towards, axis=1) / np.maximum(np.linalg.norm(towards, axis=1), 1e-30)
        # From a view to which something nearer hides the place it may be there or not.
        looks = (there > depths * (1 - SAME_SURFACE)) & (cosine < FROM_ELSEWHERE)
        looking += looks
        agreeing += looks & (there < depths * (1 + SAME_SURFACE))
    agreed = np.zeros(view.depth.shape, bool)
    agreed[rows, columns] = agreeing >= np.maximum(AGREEING, SHARE * looking)
    return agreed


def _others(views: Sequence[CoarseDepth]) -> list[list[int]]:
    """Of every view the indices of those that observe most of what it shows, most first."""
    rng = np.random.default_rng(0)
    found = []
    for index, view in enumerate(views):
        rows, columns = np.nonzero(view.depth)
        drawn = rng.permutation(len(rows))[:SAMPLED]
        points, _ = level_set.world_points(view.camera, view.depth, rows[drawn], columns[drawn])
        common = np.array([(depths_at(points, other)[1] > 0).sum() for other in views], int)
        common[index] = 0
        best = np.argsort(-common, kind="stable")[:MOST_OTHERS]
        found.append([int(other) for other in best if common[other] > 0])
    return found


def _enlarged(values: np.ndarray, camera: Camera) -> np.ndarray:
    """Values of a coarse grid of a view at its pixels, each the nearest one: between two surfaces there is none."""
    rows, columns = (
        np.minimum(((np.arange(size) + 0.5) * side / size).astype(int), side - 1)
        for size, side in zip((camera.height, camera.width), values.shape, strict=True)
    )
    return values[np.ix_(rows, columns)]


def depth_poisson(
    normals_of: NormalsOfDepth,
    num_points: int,
    reconstruction: PoissonOptions | None = None,
) -> Method:
    """Poisson through random pixels of the rendered depth, with normals of that depth.

    The level set has the bumps of every Gaussian; composited depth is the mean over several. Where splats of the near
    and the far mix, at outlines, there is no surface: `normals_of` says so by a zero.

    Args:
        normals_of: Such as `gsjax.normals.from_depth.smoothed_depth_normals`.
        num_points: Most points, over all views.
        reconstruction: Of the Poisson stage. None: its defaults.
    """

    def from_depth(gaussians: Gaussians, cameras: Sequence[Camera], pictures: Iterable[Picture]) -> SurfaceSamples:
        rng, wanted = np.random.default_rng(0), num_points // max(len(cameras), 1) + 1
        views = [
            _points_of_view(index, camera, picture, normals_of, wanted, rng)
            for index, (camera, picture) in enumerate(zip(cameras, pictures, strict=True))
        ]
        if not sum(len(points) for points, _, _ in views):
            raise NoSurfaceError(
                f"no surface to extract: no pixel of {len(views)} views has alpha > {level_set.MIN_ALPHA} and a normal"
            )
        points, normals, colors = (np.concatenate(parts) for parts in zip(*views, strict=True))
        build = poisson_through(gaussians, points, normals, colors, reconstruction)
        return SurfaceSamples(points, build, {"points": len(points)})

    return from_depth


def _points_of_view(
    index: int,
    camera: Camera,
    picture: Picture,
    normals_of: NormalsOfDepth,
    count: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, outward normals and colours of some pixels of one view."""
    level_set.check_sizes(index, camera, picture)
    depth, alphas = np.asarray(picture.depth), np.asarray(picture.alphas)
    covered = level_set.shows_surface(picture)
    depth = np.where(covered, depth, 0)
    normals = np.asarray(normals_of(depth, np.where(covered, alphas, 0), camera), np.float64)
    rows, columns = np.nonzero(covered & np.any(normals != 0, axis=-1))
    points, directions = level_set.world_points(camera, depth, rows, columns)
    outward = normals[rows, columns] @ np.asarray(camera.viewmat, np.float64)[:3, :3]
    facing = np.flatnonzero(np.sum(outward * directions, axis=-1) < -LEAST_FACING)
    drawn = rng.permutation(facing)[:count]
    colors = to_bytes(np.asarray(picture.colors)[rows[drawn], columns[drawn]])
    return points[drawn].astype(np.float32), outward[drawn].astype(np.float32), colors
