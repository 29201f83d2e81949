"""What a finished run, or a bare 3DGS file, offers to the later stages: Gaussians and cameras."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.cameras import Camera
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.io import runs
from gsjax.io.ply import read_gaussians
from gsjax.io.scenes import load_scene
from gsjax.io.splits import AUTO
from gsjax.pipeline import viewpoints
from gsjax.scene import Frame, Scene

BACKGROUNDS = {"white": np.ones(3, np.float32), "black": np.zeros(3, np.float32), "random": np.zeros(3, np.float32)}
"""Colour that pictures and scores are made over; a run trained on random ones is scored over black."""


@dataclass(frozen=True)
class Result:
    """Gaussians and the views they were made from."""

    gaussians: Gaussians  # numpy
    cameras: tuple[Camera, ...]
    names: tuple[str, ...]
    held_out: tuple[bool, ...]
    background: np.ndarray  # [3]


def write_cameras(path: Path, frames: tuple[Frame, ...]) -> None:
    """`cameras.json`: one record a view, world to camera, OpenCV axes, pixels."""
    records = [
        {
            "name": f.name,
            "width": f.width,
            "height": f.height,
            "viewmat": f.viewmat,
            "K": f.K,
            "held_out": f.held_out,
        }
        for f in frames
    ]
    runs.write_json(path, records)


def open_result(source: str | Path, *, scene: str | Path | None = None) -> Result:
    """A run folder, or any 3DGS .ply with the cameras of `scene`, or with cameras placed around it.

    Raises:
        InputError: It is neither, or unfinished, or unreadable.
    """
    source = Path(source)
    if source.is_dir():
        if not (source / "gaussians.ply").exists():
            hint = "its training has not finished" if (source / "manifest.json").exists() else "it is no run folder"
            raise InputError(f"{source}: holds no gaussians.ply; {hint}")
        gaussians = read_gaussians(source / "gaussians.ply")
        background = BACKGROUNDS[runs.read_json(source / "config.json")["background"]]
        records = runs.read_json(source / "cameras.json")
        return _result(gaussians, records, background)
    gaussians = read_gaussians(source)
    if scene is None:
        cameras = viewpoints.around(gaussians)
        return Result(
            gaussians,
            cameras,
            tuple(f"around_{index:02d}" for index in range(len(cameras))),
            (False,) * len(cameras),
            BACKGROUNDS["black"],
        )
    records = [f.__dict__ for f in load_scene(scene).frames]
    return _result(gaussians, records, BACKGROUNDS["black"])


def scene_of_run(run: Path) -> Scene:
    """The data set of a run folder, loaded as it was trained on.

    Raises:
        InputError: It is no run folder, or its data set cannot be used any more.
    """
    manifest, settings = runs.read_json(run / "manifest.json"), runs.read_json(run / "config.json")
    return load_scene(
        manifest["scene"],
        downscale=settings["downscale"],
        folder_masks=settings["masks"],
        images=settings.get("images"),  # Absent from folders of runs that could not choose.
        hold_out=settings.get("hold_out", AUTO),
    )


def frame_camera(frame: Frame) -> Camera:
    """The camera of a loaded frame, numpy."""
    return Camera(frame.viewmat, frame.K, frame.width, frame.height)  # pyright: ignore[reportArgumentType]


def _result(gaussians: Gaussians, records: list[dict[str, Any]], background: np.ndarray) -> Result:
    def camera(record: dict[str, Any]) -> Camera:
        viewmat, K = (np.asarray(record[key], np.float32) for key in ("viewmat", "K"))
        return Camera(viewmat, K, record["width"], record["height"])  # pyright: ignore[reportArgumentType]

    return Result(
        gaussians,
        tuple(camera(r) for r in records),
        tuple(r["name"] for r in records),
        tuple(bool(r["held_out"]) for r in records),
        background,
    )
