"""RUN/report.html: one file that shows a run, with its pictures inside; opens anywhere, and loads nothing."""

import sys
import time
from base64 import b64encode
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gsjax import runs
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.files import atomic_path
from gsjax.io.images import jpeg_bytes, read_image, resize
from gsjax.io.machine import peak_memory, restart_peak_memory
from gsjax.io.packages import MissingPackageError, require
from gsjax.metrics.photos import score_images
from gsjax.report import curves, view_pictures
from gsjax.report import facts as run_facts
from gsjax.report.facts import RunFacts
from gsjax.runs.photo_effects import PhotoEffects, read_photo_effects
from gsjax.runs.result import open_result, scene_of_run

FILE = "report.html"
OVERVIEW_WIDTH = 1280  # pixels


def report(folder: str | Path) -> Path:
    """Write and return `report.html` of a run, or of a scan and the runs in it; of what is not finished, what there is.

    What it shows is read from the folder's files. Pictures of held-out views are those that were kept when the run was
    scored; where a finished run has none, they are rendered now. The mesh is that of `RUN/mesh.ply`.

    Raises:
        InputError: It is no such folder, a file in it is damaged, or the report cannot be written.
    """
    folder = Path(folder)
    if (folder / "manifest.json").exists() or not (folder / "report.json").exists():
        chapters, overview = [_chapter(folder)], None
        stages = chapters[0]["stages"]
    else:
        record = json_files.read(folder / "report.json", {"stages?": {str: {}}})
        if "stages" not in record:
            raise InputError(f"{folder}: is the folder of neither a run nor a scan")
        parts = [folder / name for name in ("run", "refined")]
        chapters = [_chapter(part) for part in parts if (part / "manifest.json").exists()]
        stages, overview = run_facts.stage_rows(record["stages"]), _overview(folder / "overview.png")
    name, file = folder.resolve().name, folder / FILE
    return write_page(file, "report.html", name=name, stages=stages, overview=overview, chapters=chapters)


def report_if_installed(folder: str | Path) -> None:
    """Write the report as `report` does; without the packages of the extra `view`, print a line instead."""
    try:
        report(folder)
    except MissingPackageError as error:
        print(f"no report: {error}", file=sys.stderr)


def record_stage(run: str | Path, stage: str, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Do the work of a stage on a run, record the figures that it returns in the run, and return them.

    They, `seconds` and `peak_gib` go to `stages` in RUN/manifest.json, and the report is made anew. Where that cannot
    be written, a line says so: the work is done. Of anything but a run folder nothing is recorded.
    """
    restart_peak_memory()
    started = time.perf_counter()
    figures = work()
    spent = {"seconds": round(time.perf_counter() - started, 1), "peak_gib": round(peak_memory() / 2**30, 2)}
    if (Path(run) / "manifest.json").is_file():
        try:
            before = json_files.read(Path(run) / "manifest.json").get("stages", {})
            runs.update_manifest(run, stages={**before, stage: {**figures, **spent}})
            report(run)
        except InputError as error:
            print(f"report: {error}", file=sys.stderr)
    return figures


def write_page(path: Path, template: str, *, package: str = "gsjax.report", **content: Any) -> Path:
    """Fills a template in `templates` of a package, and writes the file; whatever it is given is escaped."""
    jinja2 = require("jinja2")
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(package),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = lambda image: f"data:image/jpeg;base64,{b64encode(image).decode()}"
    environment.globals.update(
        {name: getattr(curves, name) for name in ("WIDTH", "HEIGHT", "LEFT", "RIGHT", "TOP", "BOTTOM")}
    )
    page = environment.get_template(template).render(**content)
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace")  # Names may hold bytes of Latin-1.
    return path


def _chapter(folder: Path) -> dict[str, Any]:
    run = RunFacts.open(folder)
    return {
        "name": folder.resolve().name,
        "is_refinement": run.is_refinement,
        "read": run_facts.what_was_read(run),
        "decided": run_facts.what_was_decided(run),
        "plan": run_facts.plan(run),
        "effects": run_facts.effects(run),
        "scores": run_facts.scores(run),
        "stages": run_facts.stage_rows(run.stages),
        "charts": {axis: run_facts.charts({"": [run]}, axis) for axis in run_facts.AXES},
        "views": _views(run),
        "settings": run_facts.flat_settings(run.settings),
        "machine": {**run.manifest["machine"], **run.manifest["versions"]},
    }


def _views(run: RunFacts) -> list[dict[str, Any]]:
    """Name and pictures of the views that are shown; none before the run is done."""
    if not run.views:
        return []
    places = view_pictures.report_views(run.views)
    records = [run.views[place] for place in places]
    if records[0]["held_out"] and not (run.folder / view_pictures.FOLDER).exists():
        _render(run, {record["name"] for record in records})
    meshes = view_pictures.mesh_pictures(run.folder, records)
    views = [
        {"name": record["name"], "pictures": {**view_pictures.stored_pictures(run.folder, place), **mesh}}
        for place, record, mesh in zip(places, records, meshes, strict=True)
    ]
    return [each for each in views if each["pictures"]]


def _render(run: RunFacts, names: set[str]) -> None:
    """Keeps the pictures of a run that was scored without keeping any."""
    result, scene = open_result(run.folder), scene_of_run(run.folder)
    frames = tuple(frame for frame in scene.held_out_frames if frame.name in names)
    background, keep = run.settings["model"]["background"], view_pictures.picture_keeper(run.folder)
    effects = PhotoEffects(background=read_photo_effects(run.folder).background)
    score_images(
        result.gaussians, frames, background, photo_effects=effects, depth_mode=result.depth_mode, observe=keep
    )


def _overview(file: Path) -> bytes | None:
    if not file.exists():
        return None
    image, _ = read_image(file)
    width = min(OVERVIEW_WIDTH, image.shape[1])
    return jpeg_bytes(resize(image, width, round(image.shape[0] * width / image.shape[1])))
