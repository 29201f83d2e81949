"""A data set taken by another camera: exposure, white balance, fall-off, a sky and wrong poses put into it.

    python experiments/relit.py SCENE OUT --exposure 0.3 --balance 0.1 --corner -0.5
    python experiments/relit.py SCENE OUT --turn 0.3 --shift 0.005
    python experiments/relit.py SCENE OUT --sky 1

OUT is SCENE with other pixels in `images/` or other poses in `sparse/0/`, and `relit.json`, which tells what was put
in: gains in EV, the true viewmats where poses are wrong.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gsjax.effects.exposure import linear_light
from gsjax.io import runs
from gsjax.io.colmap_writer import write_poses
from gsjax.io.files import atomic_folder
from gsjax.io.images import write_image
from gsjax.io.scenes import load_scene
from gsjax.scene import Frame, Scene, with_pixels

HORIZON, ZENITH = np.array([1.0, 0.9, 0.75]), np.array([0.45, 0.65, 1.0])


def relight(
    scene: str | Path,
    out: str | Path,
    *,
    exposure: float = 0.0,
    balance: float = 0.0,
    corner: float = 0.0,
    turn: float = 0.0,
    shift: float = 0.0,
    sky: float = 0.0,
    seed: int = 0,
) -> Path:
    """Write a copy of a data set whose photos were taken with gains of their own, and not from where it says.

    Args:
        scene: Folder of a data set with PNGs in `images/` that fit its model, such as the built-in scene.
        out: Folder to make, absent or empty.
        exposure: Standard deviation over the photos, EV.
        balance: The same for each channel by itself.
        corner: Light at half a diagonal from the principal point against the middle's, EV.
        turn: Standard deviation of the poses' errors about each axis, degrees.
        shift: The same of their places along each axis, shares of the median distance to the points.
        sky: How far what is behind everything goes to the colours of a sky by direction, 0 to 1. Needs true labels.
        seed: Of the gains and errors.

    Returns:
        `out`.

    Raises:
        InputError: The data set cannot be used, or `out` not be written.
    """
    loaded = load_scene(scene)
    frames = loaded.frames
    rng = np.random.default_rng(seed)
    gains = exposure * rng.normal(size=(len(frames), 1)) + balance * rng.normal(size=(len(frames), 3))
    gains -= gains.mean(0)
    with atomic_folder(out) as folder:
        shutil.copytree(scene, folder, dirs_exist_ok=True)
        for frame, gain in zip(frames, gains, strict=True):
            above = _under_sky(loaded, frame, sky) if sky else frame
            write_image(folder / "images" / frame.name, _retaken(above, gain, corner))
        told = {"gains": {f.name: gain for f, gain in zip(frames, gains, strict=True)}, "corner": corner, "seed": seed}
        if turn or shift:
            depths = np.concatenate([loaded.points @ f.viewmat[2, :3] + f.viewmat[2, 3] for f in frames])
            unit = float(np.median(depths[depths > 0]))
            wrong = {f.name: _displaced(f.viewmat, np.radians(turn), shift * unit, rng) for f in frames}
            write_poses(folder / "sparse/0", wrong)
            told["viewmats"] = {f.name: f.viewmat for f in frames}
        runs.write_json(folder / "relit.json", told)
    return Path(out)


def _retaken(frame: Frame, gain: np.ndarray, corner: float) -> np.ndarray:
    x, y = np.meshgrid(np.arange(frame.width) + 0.5, np.arange(frame.height) + 0.5)
    radii2 = ((x - frame.K[0, 2]) ** 2 + (y - frame.K[1, 2]) ** 2) * 4 / (frame.width**2 + frame.height**2)
    light = np.clip(linear_light(frame.pixels().image / 255) * 2 ** (gain + corner * radii2[..., None]), 0, 1)
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(255 * coded).astype(np.uint8)


def _under_sky(scene: Scene, frame: Frame, share: float) -> Frame:
    """The frame with a sky where it shows no surface; a pixel at an edge keeps what was mixed into it."""
    assert scene.truth is not None, "the truth says what is sky"
    x, y = np.meshgrid(np.arange(frame.width) + 0.5, np.arange(frame.height) + 0.5)
    local = np.stack([(x - frame.K[0, 2]) / frame.K[0, 0], (y - frame.K[1, 2]) / frame.K[1, 1], np.ones_like(x)], -1)
    world = local @ frame.viewmat[:3, :3]
    height = 0.5 + 0.5 * (world[..., 2:] / np.linalg.norm(world, axis=-1, keepdims=True))
    color = 1 - share * (1 - ((1 - height) * HORIZON + height * ZENITH))
    pixels = frame.pixels()
    is_sky = (scene.truth.labels[frame.name]() == 0)[..., None]
    image = np.where(is_sky, np.rint(255 * color), pixels.image).astype(np.uint8)
    return with_pixels(frame, pixels._replace(image=image))


def _displaced(viewmat: np.ndarray, turn: float, shift: float, rng: np.random.Generator) -> np.ndarray:
    """The same camera turned about its centre and put elsewhere, both at random: radians, scene units."""
    error = np.eye(4)
    error[:3, :3] = Rotation.from_rotvec(turn * rng.normal(size=3)).as_matrix()
    error[:3, 3] = shift * rng.normal(size=3)
    return error @ viewmat


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("out")
    for name in ("exposure", "balance", "corner"):
        parser.add_argument(f"--{name}", type=float, default=0.0, metavar="EV")
    parser.add_argument("--turn", type=float, default=0.0, metavar="DEGREES")
    parser.add_argument("--shift", type=float, default=0.0, metavar="SHARE")
    parser.add_argument("--sky", type=float, default=0.0, metavar="SHARE")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    options = {
        name: getattr(arguments, name) for name in ("exposure", "balance", "corner", "turn", "shift", "sky", "seed")
    }
    relight(arguments.scene, arguments.out, **options)


if __name__ == "__main__":
    main()
