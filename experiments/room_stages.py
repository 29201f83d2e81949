"""Where between training and mesh are depth and normals of a room lost? Per pixel, against a depth sensor's surface.

    python experiments/room.py RUN --place truth.ply            # the sensor's mesh in the run's coordinates
    python experiments/room_stages.py truth.ply RUN [MESH ...]

Of every sixth photo, a row for each stage: the normal maps that supervised the run, the gradient of the signed distance
composited and at pixels' own surface points, the rendered depth with smoothed normals, and each mesh. Columns: mean and
median normal error, whichever side faces; median error of depth as a share of it; share of pixels within 2 %; share of
the pixels with a true depth that the stage has one for. A stage without depth of its own has that of the render.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from gsjax.cli import run_guarded
from gsjax.report import tables

EVERY, FIRST = 6, 3  # of the photos
CLOSE = 0.02  # share of the depth
HEADS = ("normal_mean_deg", "normal_median_deg", "depth_median_percent", "within_2_percent", "covered")

Surface = tuple[np.ndarray, np.ndarray]
"""Camera z `[H, W]`, 0 or infinite where there is none, and normals `[H, W, 3]` in the camera's frame, zero there."""


def run(truth_file: str, run_folder: str, meshes: Sequence[str]) -> dict[str, dict[str, float]]:
    """The figures of every stage, by its name.

    Raises:
        InputError: A file cannot be read.
    """
    from gsjax.meshing.export import read_mesh
    from gsjax.runs.result import open_result

    result = open_result(run_folder)
    truth, *scenes = (_caster(result.similarity.mesh_to_local(read_mesh(file))) for file in (truth_file, *meshes))
    indices = range(FIRST, len(result.cameras), EVERY)
    rows: dict[str, list[list[float]]] = {}
    stages = zip(indices, _rendered_stages(result, indices), strict=True)
    for index, stage in tqdm(stages, total=len(indices), desc="photos", unit="photo", leave=False):
        camera = result.cameras[index]
        true_surface = truth(camera)
        for name, surface in (stage | {file: cast(camera) for file, cast in zip(meshes, scenes, strict=True)}).items():
            rows.setdefault(name, []).append(_figures(surface, true_surface))
    return {name: dict(zip(HEADS, np.nanmean(each, axis=0).tolist(), strict=True)) for name, each in rows.items()}


def _rendered_stages(result, indices: Sequence[int]) -> Iterator[dict[str, Surface]]:
    """What the run shows of the photos, stage by stage."""
    from gsjax import render
    from gsjax.normals import sdf
    from gsjax.normals.from_depth import smoothed_depth_normals
    from gsjax.numerics import safe_normalize
    from gsjax.runs.normal_source import reduction_for

    cameras = [result.cameras[index] for index in indices]
    reduction = reduction_for(result.gaussians, cameras, result.depth_mode)
    for index, camera in zip(indices, cameras, strict=True):
        view = render(result.gaussians, camera, with_depth=True, depth_mode=result.depth_mode)
        depth = np.asarray(view.depth)

        def of(directions, depth=depth) -> Surface:
            return depth, np.asarray(safe_normalize(jnp.asarray(directions)))

        supervised = _map_of(Path(result.source), result.names[index], camera)
        yield {
            **({} if supervised is None else {"normal map": of(supervised)}),
            "composited gradient": of(sdf.sdf_gradient_map(result.gaussians, view, camera)),
            "rendered depth": of(sdf.pixel_depth_map(result.gaussians, view, camera)),
            "rendered depth, smoothed normals": of(
                smoothed_depth_normals(view.depth, view.alphas, camera, reduction=reduction)
            ),
        }


def _map_of(run_folder: Path, name: str, camera) -> np.ndarray | None:
    """The normal map of a photo, as the run stores it; None of a held-out photo."""
    from gsjax.runs.normal_source import read_map

    file = (run_folder / "normals" / name).with_suffix(".png")
    return read_map(file, camera).astype(np.float32) if file.exists() else None


def _caster(mesh) -> Callable[[object], Surface]:
    """Camera -> the surface of a mesh that it sees."""
    from gsjax.meshing.pictures import depth_of_mesh
    from gsjax.meshing.ray_queries import ray_caster
    from gsjax.normals.from_depth import depth_normals

    cast = ray_caster(mesh)

    def surface_of(camera) -> Surface:
        depth = depth_of_mesh(cast, camera)
        return depth, np.asarray(depth_normals(jnp.asarray(depth, jnp.float32), camera))

    return surface_of


def _figures(surface: Surface, true_surface: Surface) -> list[float]:
    depth, normals = surface
    true_depth, true_normals = true_surface
    is_true = (true_depth > 0) & np.any(true_normals != 0, axis=-1)
    both = is_true & (depth > 0) & np.isfinite(depth) & np.any(normals != 0, axis=-1)
    cosines = np.abs(np.sum(normals * true_normals, axis=-1))[both]
    degrees = np.degrees(np.arccos(np.minimum(cosines, 1)))
    off = np.abs(depth[both] / true_depth[both] - 1)
    if not both.any():
        return [np.nan] * 4 + [0.0]
    return [degrees.mean(), np.median(degrees), 100 * np.median(off), (off < CLOSE).mean(), both.sum() / is_true.sum()]


def main() -> None:
    """Reads the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("truth", metavar="TRUTH", help="the sensor's mesh in the run's coordinates")
    parser.add_argument("run", metavar="RUN")
    parser.add_argument("meshes", nargs="*", metavar="MESH")
    arguments = parser.parse_args()
    print(tables.compare(run(arguments.truth, arguments.run, arguments.meshes)))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
