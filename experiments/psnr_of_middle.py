"""Held-out PSNR of runs on one data set, over all pixels and over those that show the middle of the scene.

    python experiments/inside.py RUN ... --reach 2.2

needs a data set with true depth. A pixel counts as inside where its true surface point has |x| and |y| of at most the
reach; sky does not.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gsjax import cameras, tables
from gsjax.cli import guarded
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.scenes import load_scene
from gsjax.runs.result import frame_camera, open_result
from gsjax.scene import Frame, with_pixels
from gsjax.scoring.images import score_images


def compare(folders: Sequence[str], reach: float) -> dict[str, dict[str, float]]:
    """For every run: `psnr`, `psnr_inside`, and `inside`, the share of the pixels."""
    root, *others = [json_files.read(Path(folder) / "manifest.json")["scene"] for folder in folders]
    for folder, other in zip(folders[1:], others, strict=True):
        if other != root:
            raise InputError(f"{folder}: is a run on {other}, not on {root}")
    scene = load_scene(root)
    if scene.truth is None or not scene.truth.depths:
        raise InputError(f"{scene.root}: has no true depth")
    masks = [inside(frame, scene.truth.depths[frame.name](), reach) for frame in scene.held_out_frames]
    masked = tuple(
        with_pixels(frame, frame.pixels()._replace(valid=255 * mask.astype(np.uint8)))
        for frame, mask in zip(scene.held_out_frames, masks, strict=True)
    )
    figures = {}
    for folder in folders:
        gaussians = open_result(folder).gaussians
        background = json_files.read(Path(folder) / "config.json")["background"]
        figures[folder] = {
            "psnr": score_images(gaussians, scene.held_out_frames, background)["psnr"],
            "psnr_inside": score_images(gaussians, masked, background)["psnr"],
            "inside": float(np.mean(masks)),
        }
    return figures


def inside(frame: Frame, depth: np.ndarray, reach: float) -> np.ndarray:
    """`[H, W]` whether the true surface point of a pixel is within the reach of the origin along x and y."""
    camera = frame_camera(frame)
    seen = np.asarray(cameras.unproject(jnp.asarray(depth), camera))
    points = seen @ np.asarray(cameras.rotation(camera)) + np.asarray(cameras.center(camera))
    return (depth > 0) & np.all(np.abs(points[..., :2]) <= reach, axis=-1)


def main() -> None:
    """Reads the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", metavar="RUN", nargs="+", help="run folders")
    parser.add_argument("--reach", type=float, required=True, help="scene units")
    arguments = parser.parse_args()
    print(tables.compare(compare(arguments.runs, arguments.reach)))


if __name__ == "__main__":
    sys.exit(guarded(main))
