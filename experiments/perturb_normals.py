"""Which normal maps have errors of a known size? Writes them beside the true ones of a data set.

    python experiments/perturb_normals.py SCENE [--out DIR]

Reads SCENE/normals and writes into DIR (default: SCENE) the folders normals_5deg, normals_10deg and normals_20deg,
whose maps are turned by smooth fields of that mean angle, and normals_fifth_wrong, where blobs that cover a fifth of
every map say one direction of their own, as a network does that takes a picture on the wall for a room.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gsjax.cli import run_guarded
from gsjax.io.files import atomic_folder

Wrong = Callable[[np.ndarray, np.random.Generator], np.ndarray]
"""(a map `[H, W, 3]` of unit normals, zero where there is none; random numbers) -> the wrong map."""

WIDTH_SHARE = 0.1  # of the longer side: standard deviation of the blur that makes noise a smooth field


def turned(degrees: float) -> Wrong:
    """Every normal is turned, by so many degrees in the mean over the map, into directions that change smoothly."""

    def of_map(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        from scipy.optimize import brentq

        there = np.any(normals != 0, -1)
        field = np.stack([_smooth(normals.shape[:2], rng) for _ in range(3)], -1)
        sideways = field - np.sum(field * normals, -1, keepdims=True) * normals
        lengths = np.linalg.norm(sideways, axis=-1)
        if not there.any():
            return normals

        def off(scale: float) -> float:
            return float(np.mean(np.arctan(scale * lengths[there]))) - np.radians(degrees)

        moved = normals + brentq(off, 0, 1e3) * sideways
        return np.where(there[..., None], moved / np.linalg.norm(moved, axis=-1, keepdims=True).clip(1e-9), 0)

    return of_map


def partly(share: float) -> Wrong:
    """A share of every map, in blobs, says one direction of the map's own, facing the camera."""

    def of_map(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        there = np.any(normals != 0, -1)
        field = _smooth(normals.shape[:2], rng)
        direction = rng.normal(size=3)
        direction *= -np.sign(direction[2]) / np.linalg.norm(direction)
        wrong = there & (field > np.quantile(field[there], 1 - share)) if there.any() else there
        return np.where(wrong[..., None], direction, normals)

    return of_map


KINDS: dict[str, Wrong] = {
    "normals_5deg": turned(5),
    "normals_10deg": turned(10),
    "normals_20deg": turned(20),
    "normals_fifth_wrong": partly(0.2),
}


def run(scene: str, out: str, seed: int = 0) -> list[Path]:
    """Writes the folders of `KINDS` into `out`, and returns them.

    Raises:
        InputError: The data set has no true normals, or a folder cannot be written.
    """
    from gsjax.io.normal_maps import map_places, normal_maps  # Here, and not above: they import jax and OpenCV.
    from gsjax.io.scenes import load_scene

    frames = load_scene(scene).frames
    maps, places = normal_maps(Path(scene) / "normals", frames), map_places(frames)
    folders = [Path(out) / kind for kind in KINDS]
    for folder, wrong in zip(folders, KINDS.values(), strict=True):
        with atomic_folder(folder) as unfinished:
            for index, frame in enumerate(frames):
                file = unfinished / f"{places[frame.name]}.npy"
                file.parent.mkdir(parents=True, exist_ok=True)
                np.save(file, wrong(maps[frame.name](), np.random.default_rng((seed, index))).astype(np.float16))
    return folders


def _smooth(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """`[H, W]` noise without detail, of unit variance."""
    from scipy.ndimage import gaussian_filter

    field = gaussian_filter(rng.normal(size=shape), WIDTH_SHARE * max(shape), mode="reflect")
    return field / max(float(field.std()), 1e-12)


def main() -> None:
    """Reads the arguments and writes the maps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", metavar="SCENE", help="folder of a data set with true normals")
    parser.add_argument("--out", metavar="DIR", help="where the folders go (default: SCENE)")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    for folder in run(arguments.scene, arguments.out or arguments.scene, arguments.seed):
        print(folder)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
