"""What a finished run, or a bare 3DGS file, offers to the later stages: Gaussians and cameras."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.cameras import Camera
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, opacities
from gsjax.io import runs
from gsjax.io.ply import read_gaussians
from gsjax.io.scenes import load_scene
from gsjax.scene import Frame

SAMPLED_CAMERAS = 32  # Around a 3DGS file that comes without any.
SAMPLED_SIZE = 400  # Their side, pixels.
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
        records = _cameras_around(gaussians)
    else:
        records = [f.__dict__ | {"width": f.width, "height": f.height} for f in load_scene(scene).frames]
    return _result(gaussians, records, BACKGROUNDS["black"])


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


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """`[4, 4]` float32 world to camera (OpenCV axes) of a camera at `eye` that sees `target` in the middle."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # looking along up: any right will do
        right = np.cross(forward, np.roll(up, 1))
    right /= np.linalg.norm(right)
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[:3, :3] = [right, np.cross(forward, right), forward]
    viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    return viewmat


def _cameras_around(gaussians: Gaussians) -> list[dict[str, Any]]:
    """Cameras on a sphere around the opaque Gaussians (a Fibonacci lattice), looking at their median."""
    means = gaussians.means[np.asarray(opacities(gaussians)) > 0.5]
    means = means if len(means) else gaussians.means
    middle = np.median(means, axis=0)
    radius = float(np.quantile(np.linalg.norm(means - middle, axis=1), 0.9))
    height = 1 - 2 * (np.arange(SAMPLED_CAMERAS) + 0.5) / SAMPLED_CAMERAS
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(SAMPLED_CAMERAS)
    ring = np.sqrt(1 - height**2)
    directions = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], -1)
    focal = 1.2 * SAMPLED_SIZE
    K = np.array([[focal, 0, SAMPLED_SIZE / 2], [0, focal, SAMPLED_SIZE / 2], [0, 0, 1]], np.float32)
    return [
        {
            "name": f"around_{i:02d}",
            "width": SAMPLED_SIZE,
            "height": SAMPLED_SIZE,
            "viewmat": look_at(middle + 3 * radius * d, middle, np.array([0.0, 0.0, 1.0])),
            "K": K,
            "held_out": False,
        }
        for i, d in enumerate(directions)
    ]
