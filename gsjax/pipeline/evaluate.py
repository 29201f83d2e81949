"""Scores of a run: held-out images, and geometry wherever there is truth beside the images."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gsjax import gallery
from gsjax.cameras import Camera
from gsjax.effects.alignment import Draw
from gsjax.effects.alignment import align as aligned_camera
from gsjax.effects.appearance import Appearance, fitted
from gsjax.gallery import Picture
from gsjax.gaussians import Gaussians
from gsjax.io import runs
from gsjax.measures import geometry
from gsjax.measures.images import psnr, ssim
from gsjax.mesh import Mesh
from gsjax.meshing.closest import closest_on_mesh
from gsjax.meshing.export import read_mesh
from gsjax.meshing.pictures import depth_of_mesh
from gsjax.meshing.rays import ray_caster
from gsjax.normals.from_depth import depth_normals
from gsjax.pipeline.effects import Photography, appearances_of_tracks, read_photography
from gsjax.pipeline.mesh import mesh as extract
from gsjax.pipeline.perceptual import STANDARD, Measure, lpips_measures
from gsjax.pipeline.result import BACKGROUNDS, frame_camera, open_result, scene_of_run
from gsjax.render import DepthReading
from gsjax.scene import Frame, Truth

NOTHING = Photography()
Aligner = Callable[[Camera, np.ndarray, np.ndarray, Draw], Camera]
"""(camera as given, photo `[H, W, 3]` 0..1, `[H, W]` bool pixels that count, what draws) -> where it stood."""
SKY, GROUND = 0, 255  # Labels of the truth; everything between is an object.


def evaluate(
    run: str | Path,
    *,
    mesh: str | Path | None = None,
    lpips: Sequence[str | Path] = (),
    three_ways: bool = False,
    aligned: bool = False,
    zooms: Sequence[float] = (),
) -> dict[str, Any]:
    """Score a finished run on its held-out views and, where its data set brings truth, its geometry.

    Args:
        run: Run folder.
        mesh: Mesh to score against the true surface. None: `RUN/mesh.ply`, extracted now if it is absent.
        lpips: Files of weights, see `gsjax.pipeline.perceptual.lpips_measures`.
        three_ways: Score pictures in all ways of `score_images` even if the run simulated no effects.
        aligned: Score pictures from the poses that fit the photos best too, even if the run moved no cameras.
        zooms: Score pictures at so many times the size of training as well: at 0.5 against photos of half the size.

    Returns:
        What `score_images` tells of the held-out views and what the files of weights allow, at least `lpips_vgg_3dgs`
        (None without held-out views or without weights), `gaussians`, `train_seconds`, `steps`; for every zoom
        `psnr_zoom_0.5` and `ssim_zoom_0.5` (with that number); with true
        normals `normal_error_deg` and `normal_error_median_deg` of the rendered depth over object pixels and
        `normal_error_all_deg` over all surface pixels; with true depth `depth_error` (mean absolute, object pixels,
        scene units), both in held-out views; with true surface points what `score_mesh` returns, and the same errors of
        the mesh's own depth as `mesh_normal_error_deg` and so on, in `floor` those of the true mesh.

    Raises:
        InputError: The run, its data set, the mesh or the weights cannot be read.
    """
    run, measures = Path(run), lpips_measures(lpips)
    result = open_result(run)
    manifest, settings = runs.read_json(run / "manifest.json"), runs.read_json(run / "config.json")
    scene = scene_of_run(run)
    found = read_photography(run)
    if three_ways and not found.looks:
        found = found._replace(looks=appearances_of_tracks(scene))
    figures = score_images(
        result.gaussians,
        scene.held_out_frames,
        settings["background"],
        measures=measures,
        found=found.with_near(scene.frames),
        align=aligned_camera if aligned or found.moves else None,
    )
    figures.setdefault(STANDARD, None)
    for zoom in zooms:
        zoomed = scene_of_run(run, zoom=zoom).held_out_frames
        plain = Photography(background=found.background)
        scores = score_images(result.gaussians, zoomed, settings["background"], found=plain)
        figures |= {f"{name}_zoom_{zoom:g}": scores[name] for name in ("psnr", "ssim")}
    figures |= {
        "gaussians": result.gaussians.num_gaussians,
        "train_seconds": manifest.get("train_seconds"),
        "steps": manifest.get("steps"),
    }
    truth = scene.truth
    if truth is None:
        return figures
    figures |= score_surface(result.gaussians, scene.held_out_frames, truth, result.depth_mode)
    if truth.points is not None and truth.point_normals is not None:
        file = Path(mesh) if mesh is not None else run / "mesh.ply"
        if mesh is None and not file.exists():
            extract(run, file)
        scored, true = read_mesh(file), None if truth.mesh is None else read_mesh(truth.mesh)
        figures |= score_mesh(scored, truth.points, truth.point_normals, true)
        figures |= score_mesh_views(scored, scene.held_out_frames, truth)
        if true is not None:
            figures["floor"] |= score_mesh_views(true, scene.held_out_frames, truth)
    return figures


def score_mesh(mesh: Mesh, seen_points: np.ndarray, seen_normals: np.ndarray, true_mesh: Mesh | None) -> dict[str, Any]:
    """How far a mesh is from the true surface: from its triangles where they are known, else from its points.

    Args:
        mesh: The prediction.
        seen_points: `[P, 3]` points of the true surface that cameras saw, world.
        seen_normals: `[P, 3]` its normals there.
        true_mesh: The true triangles, where they are known.

    Returns:
        `chamfer`, `accuracy`, `completeness`, `fscore`, `normal_consistency` and the rest that
        `gsjax.measures.geometry.compare_to_surface` tells; `distances`, "point to surface" or, without true triangles,
        "point to point"; with true triangles also `floor`: the same scores of the true mesh itself.

    Raises:
        InputError: Nothing of the mesh lies where cameras saw something.
    """
    if true_mesh is None:
        return geometry.compare_to_truth(mesh, seen_points, seen_normals) | {"distances": "point to point"}
    found, floor = (
        geometry.compare_to_surface(each, true_mesh, seen_points, seen_normals, closest_on_mesh)
        for each in (mesh, true_mesh)
    )
    return found | {"distances": "point to surface", "floor": floor}


def score_images(
    gaussians: Gaussians,
    frames: tuple[Frame, ...],
    background: str,
    *,
    measures: Mapping[str, Measure] = MappingProxyType({}),
    found: Photography = NOTHING,
    align: Aligner | None = None,
    depth_mode: DepthReading = "plane",
    observe: Callable[[Frame, np.ndarray, Picture], None] = lambda *_: None,
) -> dict[str, Any]:
    """Mean PSNR and SSIM over frames, as 3DGS defines them (float renders, every pixel that is valid); None of none.

    Args:
        gaussians: The scene.
        frames: Photos that it was not trained on.
        background: Colour behind it, where `found` has none that was learned.
        measures: Further ones by name. They see pictures in 0..1, both black where a pixel is not valid.
        found: What the photos' cameras did to the light, and what is behind all, where training took that in.
        align: Finds the pose that a photo was taken from; None: given poses are all that is scored.
        depth_mode: Of the pictures' depth, which no score looks at.
        observe: Told of every frame, of the photo `[H, W, 3]` that it is compared with, and of its picture.

    Returns:
        `psnr`, `ssim` and `measures`: of the render as it is, the mean photo of the scene; `views`. With `found.near`
        also `psnr_near_gains`, `ssim_near_gains`: after the fall-off that was learned and the gains of the photos taken
        near this one, of which nothing is used. With `found.looks` also `psnr_track_gains`, `ssim_track_gains`: with
        the gains that its own tracks tell; and `psnr_fitted`, `ssim_fitted`: of the render as it is, after the affine
        map of its colours that fits the photo best, which sees the answer. With `align` each of these also with
        `_aligned`: from the pose that fits the photo best with the Gaussians as they are, which sees the answer too.
    """
    lights = {"_near_gains": found.near, "_track_gains": found.looks}
    ways = ("", *(way for way, looks in lights.items() if looks), *(("_fitted",) if found.looks else ()))
    poses = ("", "_aligned") if align else ("",)
    names = [f"{score}{way}{pose}" for pose in poses for way in ways for score in ("psnr", "ssim")]
    if not frames:
        return {**dict.fromkeys((*names, *measures)), "views": 0}
    color = BACKGROUNDS[background] if found.background is None else found.background
    gaussians = jax.tree.map(jnp.asarray, gaussians)
    draw = partial(gallery.pictures, gaussians, background=color, depth_mode=depth_mode)
    scores = []
    for frame, picture in zip(frames, draw([frame_camera(f) for f in frames]), strict=True):
        image, matte, valid = frame.pixels()
        target = image.astype(np.float32) / 255
        if matte is not None:
            coverage = matte[..., None].astype(np.float32) / 255
            target = target * coverage + (1 - coverage) * color
        observe(frame, target, picture)
        valid = np.ones(target.shape[:2], bool) if valid is None else valid > 127
        lit = {way: _as_taken(looks, frame, None if matte is None else color) for way, looks in lights.items()}
        shown = [picture]
        if align:
            shown += draw([align(frame_camera(frame), target, valid, partial(_taken, draw, lit["_track_gains"]))])
        renders = []
        for each in shown:
            of_way = {"": each.colors, **{way: taken(each).colors for way, taken in lit.items() if way in ways}}
            if found.looks:
                of_way["_fitted"] = np.clip(fitted(each.colors, target, valid), 0, 1)
            renders += [of_way[way] for way in ways]
        pair = [np.clip(colors, 0, 1) * valid[..., None] for colors in (picture.colors, target)]
        scores.append(
            [each for render in renders for each in _scores(*map(jnp.asarray, (render, target, valid)))]
            + [measure(*pair) for measure in measures.values()]
        )
    means = np.asarray(scores, np.float64).mean(0).tolist()
    return {**dict(zip((*names, *measures), means, strict=True)), "views": len(scores)}


def _taken(
    draw: Callable[[Sequence[Camera]], Iterable[Picture]],
    taken: Callable[[Picture], Picture],
    cameras: Sequence[Camera],
) -> list[Picture]:
    return [taken(picture) for picture in draw(cameras)]


def _as_taken(looks: Mapping[str, Appearance], frame: Frame, under: np.ndarray | None) -> Callable[[Picture], Picture]:
    """What a photo's camera makes of a picture; `under`: the colour that we put behind its matte."""
    if not looks:
        return lambda picture: picture
    factor = looks[frame.name].factor(frame)

    def taken(picture: Picture) -> Picture:
        behind = 0 if under is None else (1 - picture.alphas)[..., None] * under
        return picture._replace(colors=np.clip((picture.colors - behind) * factor + behind, 0, 1))

    return taken


@jax.jit
def _scores(image: jax.Array, target: jax.Array, valid: jax.Array) -> tuple[jax.Array, jax.Array]:
    return psnr(image, target, valid), ssim(image, target, valid)


def score_surface(
    gaussians: Gaussians, frames: tuple[Frame, ...], truth: Truth, depth_mode: DepthReading = "plane"
) -> dict[str, Any]:
    """Errors of the rendered depth and of its normals against true maps, pooled over the pixels of all frames."""
    frames = _with_maps(frames, truth)
    if not frames:
        return {}
    cameras = [frame_camera(f) for f in frames]
    pictures = gallery.pictures(gaussians, cameras, BACKGROUNDS["black"], depth_mode)
    return _score_depths((picture.depth for picture in pictures), frames, truth)


def score_mesh_views(mesh: Mesh, frames: tuple[Frame, ...], truth: Truth) -> dict[str, Any]:
    """The same of the depth at which rays meet a mesh, names with "mesh_" before them."""
    cast, frames = ray_caster(mesh), _with_maps(frames, truth)
    depths = (depth_of_mesh(mesh, f.viewmat, f.K, f.width, f.height, cast=cast) for f in frames)
    return {f"mesh_{name}": value for name, value in _score_depths(depths, frames, truth).items()}


def _with_maps(frames: tuple[Frame, ...], truth: Truth) -> tuple[Frame, ...]:
    return tuple(f for f in frames if f.name in truth.normals or f.name in truth.depths)


def _score_depths(depths: Iterable[np.ndarray], frames: tuple[Frame, ...], truth: Truth) -> dict[str, Any]:
    """Errors of depth maps `[H, W]`, one a frame, and of their normals against true maps, where there are any."""
    found, true, objects, depth_errors = [], [], [], []
    for frame, depth in zip(frames, depths, strict=True):
        is_object = np.ones(depth.shape, bool)
        if frame.name in truth.labels:
            labels = truth.labels[frame.name]()
            is_object = (labels != SKY) & (labels != GROUND)
        if frame.name in truth.normals:
            found.append(np.asarray(depth_normals(jnp.asarray(depth), frame_camera(frame))).reshape(-1, 3))
            true.append(truth.normals[frame.name]().reshape(-1, 3))
            objects.append(is_object.reshape(-1))
        if frame.name in truth.depths:
            known = truth.depths[frame.name]()
            both = is_object & (known > 0) & (depth > 0)
            depth_errors.append(np.abs(known - depth)[both])
    figures: dict[str, Any] = {}
    if found:
        maps, known, mask = np.concatenate(found), np.concatenate(true), np.concatenate(objects)
        on_objects = geometry.normal_error_degrees(maps, known, mask)
        anywhere = geometry.normal_error_degrees(maps, known, np.ones_like(mask))
        figures |= {
            "normal_error_deg": on_objects["mean"],
            "normal_error_median_deg": on_objects["median"],
            "normal_error_all_deg": anywhere["mean"],
        }
    if depth_errors:
        figures["depth_error"] = float(np.concatenate(depth_errors).mean())
    return figures
