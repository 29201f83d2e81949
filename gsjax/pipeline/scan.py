"""The pipeline in one go: photos or a video to a textured mesh, each stage where its command would leave it."""

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Unpack

from gsjax import config
from gsjax.binding.refinement import Refinement
from gsjax.effects.simulation import NO_EFFECTS, Effects
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.files import make_folder
from gsjax.io.locks import LOCK, lock_folder
from gsjax.io.machine import machine, peak_memory, restart_peak_memory, versions
from gsjax.io.scenes import is_data_set
from gsjax.io.sfm import FILES, Reconstruction
from gsjax.io.temporary_files import is_temporary, sweep
from gsjax.meshing.export import read_mesh, read_textured
from gsjax.meshing.mesh_method import Method, method_name
from gsjax.meshing.methods import AUTO
from gsjax.meshing.pictures import texture_colors
from gsjax.pipeline.mesh import mesh
from gsjax.pipeline.refine import refine
from gsjax.pipeline.texture import texture
from gsjax.pipeline.train import train
from gsjax.planning.warm_start import pieces_record
from gsjax.rendering import gallery
from gsjax.report.figures import draw_panels
from gsjax.report.page import report as write_report
from gsjax.report.pictures import mesh_picture, surface_picture
from gsjax.runs import is_finished
from gsjax.runs.result import open_result
from gsjax.scene.colors import to_bytes
from gsjax.settings import Settings
from gsjax.training.densification.rules import DensificationRule


class Stage(NamedTuple):
    """One command of the pipeline."""

    name: str
    is_done: Callable[[], bool]
    run: Callable[[], Mapping[str, Any]]  # what it reports


def scan(
    source: str | Path,
    out: str | Path,
    settings: Settings | Mapping[str, Any],
    refinement: Refinement | Mapping[str, Any],
    *,
    terms: Mapping[str, Any] = MappingProxyType({}),
    densification: DensificationRule | None = None,
    effects: Effects = NO_EFFECTS,
    method: str | Method = AUTO,
    progress: Callable[[str], None] = print,
    **reconstruction: Unpack[Reconstruction],
) -> dict[str, Any]:
    """Photos, a video or a data set to a textured mesh; stages that an earlier call has finished are not done again.

    Args:
        source: Folder of photos, a video, or a data set that `train` reads (then nothing is reconstructed first).
        out: Folder for everything: `scene/` (sfm), `run/` with `run/mesh.ply` (train, mesh), `refined/` (refine),
            `mesh.glb` (texture), `overview.png`, `report.json`, `report.html`.
        settings: Of the training, as `gsjax.pipeline.train` takes them.
        refinement: Of the mesh, as `gsjax.pipeline.refine` takes it.
        terms: Passed to `gsjax.pipeline.train`, as `densification` and `effects` are. To resume they are needed again.
        densification: The same.
        effects: The same.
        method: Passed to `gsjax.pipeline.mesh`.
        progress: Receives the name of every stage as it begins.
        **reconstruction: Options of `gsjax.io.sfm.reconstruct`, for photos or a video.

    Returns:
        The report: figures of every stage with its `seconds` and `peak_gib`, `mesh`, `picture`, `machine`, `versions`.

    Raises:
        InputError: A stage cannot be done, `out` was begun with something else, or a data set is to be reconstructed.
    """
    settings, refinement = config.as_record(Settings, settings), config.as_record(Refinement, refinement)
    source, out = Path(source), Path(out)
    if reconstruction and is_data_set(source):
        options = " and ".join(reconstruction)
        raise InputError(f"{source}: is a data set, whose cameras are known; {options}: for photos or a video only")
    pieces: dict[str, Any] = {"terms": terms, "densification": densification, "effects": effects}
    configs = {"settings": config.to_dict(settings), "refinement": config.to_dict(refinement)}
    chosen_method = {} if method == AUTO else {"method": method_name(method) if callable(method) else method}
    request = _request(source, configs, reconstruction) | pieces_record(**pieces) | chosen_method
    stages = _stages(
        source,
        out,
        reconstruction,
        partial(train, settings=settings, **pieces),
        partial(mesh, method=method),
        partial(refine, settings=refinement),
    )
    _require_scan(out)  # Before anything of ours is in it.
    with lock_folder(make_folder(out)):
        sweep(out)
        report = _report_so_far(out, request)
        for stage in stages:
            if not (stage.is_done() and stage.name in report["stages"]):
                progress(f"scan: {stage.name}")
                _do(stage, out, report)
        return _finish(out, report)


def _finish(out: Path, report: dict[str, Any]) -> dict[str, Any]:
    """Write the report of all stages, its page and the picture."""
    report |= {
        "mesh": str(out / "mesh.glb"),
        "picture": str(_overview(out)),
        "machine": machine(),
        "versions": versions(),
    }
    json_files.write(out / "report.json", report)
    write_report(out)
    return report


def _do(stage: Stage, out: Path, report: dict[str, Any]) -> None:
    """One stage, and its entry in the report. What was killed between the two is done again, and leaves the same."""
    started, before = time.perf_counter(), report["stages"].get(stage.name, {}).get("seconds", 0.0)
    restart_peak_memory()
    try:
        figures = stage.run()
    except InputError:
        _forget_if_empty(out)
        raise
    report["stages"][stage.name] = {
        **figures,
        "seconds": round(before + time.perf_counter() - started, 1),
        "peak_gib": round(peak_memory() / 2**30, 2),
    }
    json_files.write(out / "report.json", report)


def table(report: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """What a person wants to read of the report: a row a stage, for `gsjax.report.tables.compare`."""
    names = ("seconds", "peak_gib", "registered", "psnr", "psnr_near_gains", "ssim", "gaussians", "faces", "seen_share")
    return {
        stage: {name: figures[name] for name in names if name in figures} for stage, figures in report["stages"].items()
    }


def _require_scan(out: Path) -> None:
    """Raises InputError where a folder holds what is no scan's."""
    if out.is_dir() and not (out / "report.json").exists():
        for path in out.iterdir():
            if path.name != LOCK and not is_temporary(path):
                raise InputError(f"{out}: this folder is not empty and holds no scan; choose another")


def _report_so_far(out: Path, request: Mapping[str, Any]) -> dict[str, Any]:
    """The report so far of a scan that was begun with the same wishes, or a new one."""
    file = out / "report.json"
    if file.exists():
        report = json_files.read(file, {"asked": {str: object}, "stages": {str: {"seconds?": (None, float)}}})
        previous = report.get("asked", {})
        for key in {**request, **previous}:
            if previous.get(key) != request.get(key):
                raise InputError(f"{out}: was begun with another {key}; choose another folder")
        return report
    report = {"asked": dict(request), "stages": {}}
    json_files.write(file, report)
    return report


def _request(source: Path, configs: Mapping[str, Any], reconstruction: Reconstruction) -> dict[str, Any]:
    """The request as the report keeps it: files by their paths from the root, wherever the scan is called again."""
    files = {name: str(Path(file).resolve()) for name in FILES if (file := reconstruction.get(name)) is not None}
    return {"source": str(source.resolve()), "frames": None, **configs, **reconstruction, **files}


def _forget_if_empty(out: Path) -> None:
    """Removes the folder of a scan that came to nothing: the next try may be another."""
    if {file.name for file in out.iterdir()} == {LOCK, "report.json"}:
        for name in (LOCK, "report.json"):
            (out / name).unlink()
        with suppress(OSError):  # A link.
            out.rmdir()


def _stages(
    source: Path,
    out: Path,
    reconstruction: Reconstruction,
    train_scene: Callable[..., Mapping[str, Any]],  # (scene, run)
    extract: Callable[..., Mapping[str, Any]],  # (run, mesh)
    refine_run: Callable[..., Mapping[str, Any]],  # (run, refined run)
) -> list[Stage]:
    scene = source if is_data_set(source) else out / "scene"
    run, refined, coarse, textured = out / "run", out / "refined", out / "run/mesh.ply", out / "mesh.glb"
    sfm = [] if scene == source else [Stage("sfm", scene.exists, lambda: _reconstruct(source, scene, reconstruction))]
    return [
        *sfm,
        Stage("train", lambda: is_finished(run), lambda: train_scene(scene, run, resume=run.exists())),
        Stage("mesh", coarse.exists, lambda: extract(run, coarse)),
        Stage("refine", lambda: is_finished(refined), lambda: refine_run(run, refined, resume=refined.exists())),
        Stage("texture", textured.exists, lambda: texture(refined, refined / "mesh.ply", textured)),
    ]


def _reconstruct(source: Path, scene: Path, reconstruction: Reconstruction) -> dict[str, Any]:
    from gsjax.io import sfm  # pycolmap: only where there is something to reconstruct.

    if scene.exists():
        return asdict(sfm.read_report(scene))
    return asdict(sfm.reconstruct(source, scene, **reconstruction))


def _overview(out: Path) -> Path:
    """overview.png: one photo's view as Gaussians, as normals, and as the meshes."""
    result, textured = open_result(out / "run"), read_textured(out / "mesh.glb")
    local = result.similarity.mesh_to_local
    coarse, refined = (local(read_mesh(out / folder / "mesh.ply")) for folder in ("run", "refined"))
    assert textured is not None, "the scan wrote its texture"
    index = next((i for i, held_out in enumerate(result.held_out) if held_out), 0)
    camera = result.cameras[index]
    picture = next(gallery.pictures(result.gaussians, [camera], result.background, result.depth_mode))

    panels = {
        f"Gaussians, {result.names[index]}": to_bytes(picture.colors),
        "normals": surface_picture(picture.depth, camera),
        "coarse mesh": mesh_picture(coarse, camera),
        "refined mesh": mesh_picture(refined, camera),
        "refined mesh, textured": mesh_picture(local(textured.mesh), camera, texture_colors(textured)),
    }
    return draw_panels(panels, out / "overview.png", columns=5)
