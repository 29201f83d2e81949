"""Effects that a data set requires: a table, a file of it, and pictures of the evidence."""

from pathlib import Path
from typing import Any

import numpy as np

from gsjax.effects import sky, vignetting
from gsjax.effects.diagnosis import Diagnosis
from gsjax.errors import InputError
from gsjax.io import json_files, normal_folders
from gsjax.io.files import atomic_path
from gsjax.io.scenes import load_scene
from gsjax.planning.effects import diagnose_scene
from gsjax.planning.sparse_views import (
    FAR_APART,
    FEW,
    FEWEST,
    LONG,
    SHORTEST,
    angle_between_photos,
    is_tried,
    needs_dropout,
)
from gsjax.report.figures import new_figure
from gsjax.runs.normal_filter import score_folder
from gsjax.runs.outputs import require_apart
from gsjax.scene import Scene

CHANNELS = ("red", "green", "blue")


def diagnose(
    scene: str | Path, *, json: str | Path | None = None, downscale: float = 1.0, images: str | None = None
) -> dict[str, Any]:
    """Search photos and tracks for effects that training may simulate; nothing is trained.

    Args:
        scene: Folder of the data set, see `gsjax.io.scenes.load_scene`.
        json: File for what is returned; pictures of it go next to it, with the suffix .png. None: nothing is written.
        downscale: Read photos so many times smaller.
        images: Folder of the photos, absolute or in `scene`. None: searched for.

    Returns:
        `effects`: by name `on`, `evidence` (None: unknown), `unit`, `noise`, `threshold`, `note`;
        `photos`: `name`, `gains` (EV in red, green, blue against the mean photo, or None), `sharpness`,
        `pose_step_px` (or None), `sky` (share of its pixels);
        `normals`: by folder of maps that `gsjax normals` made there, see `gsjax.runs.normal_filter.record`;
        `apart`: see `apart`.

    Raises:
        InputError: The data set cannot be used, or a file not be written.
    """
    if json is not None and Path(json).suffix != ".json":
        raise InputError(f"json={json}: the name of the file must end in .json, its pictures will end in .png")
    for output in () if json is None else (Path(json), Path(json).with_suffix(".png")):
        require_apart(output, scene, images)
    loaded = load_scene(scene, downscale=downscale, images=images)
    diagnosis = diagnose_scene(loaded)
    folders = sorted(path.parent for path in Path(scene).glob(f"*/{normal_folders.MANIFEST}"))
    record = diagnosis.record() | {
        "normals": {folder.name: score_folder(folder, loaded) for folder in folders},
        "apart": apart(loaded),
    }
    if json is not None:
        json_files.write(json, record)
        draw(diagnosis, Path(json).with_suffix(".png"))
    return record


def rows(record: dict[str, Any]) -> list[list[str]]:
    """Return the table of a diagnosis, its head first."""
    rows = [["effect", "decision", "evidence", "threshold", "note"]]
    for name, effect in record["effects"].items():
        decision, evidence = "on" if effect["on"] else "off", _evidence(effect, effect["unit"])
        rows.append([name, decision, evidence, f"{effect['threshold']:g}", effect["note"]])
    return rows


def normals_rows(record: dict[str, Any]) -> list[list[str]]:
    """Return the table of the folders of normal maps, its head first; empty where there are none."""
    if not record["normals"]:
        return []
    rows = []
    for name, figures in record["normals"].items():
        decision, share = "kept" if figures["kept"] else "rejected", f"{100 * figures['share']:.0f} %"
        rows.append([name, decision, _evidence(figures, ""), f"{figures['threshold']:g}", share, figures["note"]])
    return [["normals", "decision", "evidence", "threshold", "counts", "note"], *rows]


def apart(scene: Scene) -> dict[str, Any]:
    """How many `photos` are trained on, `degrees` between them, and whether validation runs decide (`tried`).

    Degrees are those of `gsjax.planning.sparse_views.angle_between_photos`, None without tracks.
    """
    photos, angle = len(scene.train_frames), angle_between_photos(scene)
    return {"photos": photos, "degrees": angle, "tried": is_tried(photos, angle, SHORTEST)}


def apart_line(apart: dict[str, Any]) -> str:
    """Return the record of `apart` in words, with the consequence for training."""
    photos, angle, is_tried = (apart[key] for key in ("photos", "degrees", "tried"))
    line = f"photos: {photos} to train on, " + (
        "unknown angle, no tracks" if angle is None else f"{angle:.0f} degrees apart, seen from what they show"
    )
    if is_tried:
        return f"{line}: presets try whether holding training back helps (sparse_views)"
    if needs_dropout(photos, angle, LONG):
        return f"{line}: runs of {LONG:,} steps and more leave Gaussians out of every step (sparse_views)"
    return f"{line}; presets try to hold training back with {FEWEST} to {FEW}, or from {FAR_APART:g} degrees on"


def draw(diagnosis: Diagnosis, path: Path) -> Path:
    """Draw gains, fall-off, bright smooth pixels, sharpness and sky of the photos as one picture."""
    figure = new_figure(18, 7.5)
    gains, corner, most_sky, bare, sharpness, skies = figure.subplots(2, 3).flat
    photos = np.arange(len(diagnosis.observations.frames))
    if diagnosis.gains is None:
        for axes in (gains, corner):
            axes.text(0.5, 0.5, "no tracks", ha="center", transform=axes.transAxes)
    else:
        for channel, color in enumerate(CHANNELS):
            gains.plot(photos, diagnosis.gains.fit.gains[:, channel], ".-", color=color, linewidth=0.8, label=color)
        gains.legend()
        radii2, light, slope = vignetting.profile(diagnosis.observations, diagnosis.gains)
        corner.plot(np.sqrt(radii2), light, "k.")
        at = np.linspace(0, 1, 50)
        corner.plot(at, slope * at**2, "k", linewidth=0.8)
    bare.bar(photos, [100 * facts.sky_share for facts in diagnosis.observations.facts])
    sharp = np.array([facts.sharpness for facts in diagnosis.observations.facts])
    sharpness.bar(photos, sharp / max(float(np.median(sharp)), 1e-12))
    sharpness.axhline(1 - diagnosis.effects["blur"].threshold, color="red", linewidth=0.8)
    frames = diagnosis.observations.frames
    shares = [diagnosis.sky[frame.name].mean() if frame.name in diagnosis.sky else 0.0 for frame in frames]
    skies.bar(photos, [100 * share for share in shares])
    frame = frames[int(np.argmax(shares))]
    most_sky.imshow(sky.tinted(frame.pixels().image, diagnosis.sky.get(frame.name)))
    most_sky.set_axis_off()
    titles = {
        gains: ("gains of every photo", "photo", "EV"),
        corner: ("fall-off", "distance from the principal point, half diagonals", "EV"),
        bare: ("bright, smooth and unmatched", "photo", "% of its pixels"),
        sharpness: ("sharpness of every photo", "photo", "of the median"),
        skies: ("open sky", "photo", "% of its pixels"),
        most_sky: (f"most sky (magenta): {frame.name}" if diagnosis.sky else "no sky", "", ""),
    }
    for axes, (title, x, y) in titles.items():
        axes.set(title=title, xlabel=x, ylabel=y)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)
    return path


def _evidence(figures: dict[str, Any], unit: str) -> str:
    if figures["evidence"] is None:
        return "-"
    noise = "" if figures["noise"] is None else f" +-{figures['noise']:.2g}"
    return f"{figures['evidence']:.2f}{noise} {unit}".rstrip()
