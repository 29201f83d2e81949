"""A data set taken by another camera: exposure, white balance and fall-off of known size put into its photos.

    python experiments/relit.py SCENE OUT --exposure 0.3 --balance 0.1 --corner -0.5

OUT is SCENE with other pixels in `images/`, and `relit.json`, which tells what was put in, in EV.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np

from gsjax.effects.exposure import linear_light
from gsjax.io import runs
from gsjax.io.files import atomic_folder
from gsjax.io.images import write_image
from gsjax.io.scenes import load_scene
from gsjax.scene import Frame


def relight(
    scene: str | Path, out: str | Path, *, exposure: float, balance: float, corner: float, seed: int = 0
) -> Path:
    """Write a copy of a data set whose photos were taken with gains of their own.

    Args:
        scene: Folder of a data set with PNGs in `images/` that fit its model, such as the built-in scene.
        out: Folder to make, absent or empty.
        exposure: Standard deviation over the photos, EV.
        balance: The same for each channel by itself.
        corner: Light at half a diagonal from the principal point against the middle's, EV.
        seed: Of the gains.

    Returns:
        `out`.

    Raises:
        InputError: The data set cannot be used, or `out` not be written.
    """
    frames = load_scene(scene).frames
    rng = np.random.default_rng(seed)
    gains = exposure * rng.normal(size=(len(frames), 1)) + balance * rng.normal(size=(len(frames), 3))
    gains -= gains.mean(0)
    with atomic_folder(out) as folder:
        shutil.copytree(scene, folder, dirs_exist_ok=True)
        for frame, gain in zip(frames, gains, strict=True):
            write_image(folder / "images" / frame.name, _retaken(frame, gain, corner))
        told = {"gains": {f.name: gain for f, gain in zip(frames, gains, strict=True)}, "corner": corner, "seed": seed}
        runs.write_json(folder / "relit.json", told)
    return Path(out)


def _retaken(frame: Frame, gain: np.ndarray, corner: float) -> np.ndarray:
    x, y = np.meshgrid(np.arange(frame.width) + 0.5, np.arange(frame.height) + 0.5)
    radii2 = ((x - frame.K[0, 2]) ** 2 + (y - frame.K[1, 2]) ** 2) * 4 / (frame.width**2 + frame.height**2)
    light = np.clip(linear_light(frame.pixels().image / 255) * 2 ** (gain + corner * radii2[..., None]), 0, 1)
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(255 * coded).astype(np.uint8)


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("out")
    for name in ("exposure", "balance", "corner"):
        parser.add_argument(f"--{name}", type=float, default=0.0, metavar="EV")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    options = {name: getattr(arguments, name) for name in ("exposure", "balance", "corner", "seed")}
    relight(arguments.scene, arguments.out, **options)


if __name__ == "__main__":
    main()
