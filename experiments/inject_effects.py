"""Which data set has effects of a known size? Writes one: exposure, white balance, fall-off, sky, squares, wrong poses.

    python experiments/inject_effects.py SCENE OUT --exposure 0.3 --balance 0.1 --corner -0.5
    python experiments/inject_effects.py SCENE OUT --turn 0.3 --shift 0.005
    python experiments/inject_effects.py SCENE OUT --sky 1
    python experiments/inject_effects.py SCENE OUT --pasted 0.3

OUT is SCENE with other pixels in `images/` or other poses in `sparse/0/`, and `injected.json`, which tells what was put
in: gains in EV, the true viewmats where poses are wrong. `gsjax diagnose` and `gsjax train --effects` should find it.
"""

import argparse
import shutil
import sys
from pathlib import Path

import numpy as np

from gsjax.cli import run_guarded
from gsjax.io import json_files
from gsjax.io.files import atomic_folder
from gsjax.scene import Frame, Scene, with_pixels
from gsjax.similarity import IDENTITY

HORIZON, ZENITH = np.array([1.0, 0.9, 0.75]), np.array([0.45, 0.65, 1.0])
SQUARES, SIDE = 4, 0.16  # pasted into a photo, and the side of each in that of a square of its area: a tenth of it


def inject(
    scene: str | Path,
    out: str | Path,
    *,
    exposure: float = 0.0,
    balance: float = 0.0,
    corner: float = 0.0,
    turn: float = 0.0,
    shift: float = 0.0,
    sky: float = 0.0,
    pasted: float = 0.0,
    seed: int = 0,
) -> Path:
    """Write a copy of a data set whose photos were taken with gains of their own, and not from where it says.

    Args:
        scene: Folder of a data set with PNGs in `images/` that fit its model, such as the built-in scene.
        out: Folder to make, absent or empty.
        exposure: Standard deviation over the photos, EV.
        balance: The same for each channel by itself.
        corner: Light at half a diagonal from the principal point against the middle's, EV.
        turn: Standard deviation of the poses' errors about each axis, degrees. What is an error of the world rather
            than of the photos that are trained on is taken off.
        shift: The same of their places along each axis, shares of the median distance to the points.
        sky: How far what is behind everything goes to the colours of a sky by direction, 0 to 1. Needs true labels.
        pasted: Share of the photos that show squares of one colour each, which stood nowhere: a tenth of their pixels.
        seed: Of the gains, errors and squares.

    Returns:
        `out`.

    Raises:
        InputError: The data set cannot be used, or `out` not be written.
    """
    from gsjax.io.colmap_writer import write_poses  # Here, and not above: they import jax and OpenCV.
    from gsjax.io.images import write_image
    from gsjax.io.scenes import load_scene

    loaded = load_scene(scene, similarity=IDENTITY)  # Its poses are written back.
    frames = loaded.frames
    rng = np.random.default_rng(seed)
    gains = exposure * rng.normal(size=(len(frames), 1)) + balance * rng.normal(size=(len(frames), 3))
    gains -= gains.mean(0)
    strangers = rng.permutation(len(frames))[: round(pasted * len(frames))]
    with atomic_folder(out) as folder:
        shutil.copytree(scene, folder, dirs_exist_ok=True)
        for index, (frame, gain) in enumerate(zip(frames, gains, strict=True)):
            above = _under_sky(loaded, frame, sky) if sky else frame
            image = _retaken(above, gain, corner)
            write_image(folder / "images" / frame.name, _pasted_over(image, rng) if index in strangers else image)
        told = {"gains": {f.name: gain for f, gain in zip(frames, gains, strict=True)}, "corner": corner, "sky": sky}
        told["seed"] = seed
        if turn or shift:
            write_poses(folder / "sparse/0", _displaced(loaded, np.radians(turn), shift, rng))
            told["viewmats"] = {f.name: f.viewmat for f in frames}
        json_files.write(folder / "injected.json", told)
    return Path(out)


def _retaken(frame: Frame, gain: np.ndarray, corner: float) -> np.ndarray:
    from gsjax.colors import linear_to_srgb, srgb_to_linear

    x, y = np.meshgrid(np.arange(frame.width) + 0.5, np.arange(frame.height) + 0.5)
    radii2 = ((x - frame.K[0, 2]) ** 2 + (y - frame.K[1, 2]) ** 2) * 4 / (frame.width**2 + frame.height**2)
    light = np.clip(srgb_to_linear(frame.pixels().image / 255) * 2 ** (gain + corner * radii2[..., None]), 0, 1)
    return np.rint(255 * linear_to_srgb(light)).astype(np.uint8)


def _pasted_over(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The photo with `SQUARES` of one colour each, anywhere within it."""
    height, width = image.shape[:2]
    side = max(1, round(SIDE * (height * width) ** 0.5))
    image = image.copy()
    for row, column in zip(*(rng.integers(0, most - side + 1, SQUARES) for most in (height, width)), strict=True):
        image[row : row + side, column : column + side] = rng.integers(0, 256, 3)
    return image


def _under_sky(scene: Scene, frame: Frame, share: float) -> Frame:
    """The frame with a sky where it shows no surface; a pixel at an edge keeps what was mixed into it."""
    assert scene.truth is not None, "the truth says what is sky"
    pixels = frame.pixels()
    is_sky = (scene.truth.labels[frame.name]() == 0)[..., None]
    image = np.where(is_sky, np.rint(255 * sky_color(frame, share)), pixels.image).astype(np.uint8)
    return with_pixels(frame, pixels._replace(image=image))


def sky_color(frame: Frame, share: float) -> np.ndarray:
    """`[H, W, 3]` 0..1 by direction, from white to `HORIZON` and `ZENITH`."""
    x, y = np.meshgrid(np.arange(frame.width) + 0.5, np.arange(frame.height) + 0.5)
    local = np.stack([(x - frame.K[0, 2]) / frame.K[0, 0], (y - frame.K[1, 2]) / frame.K[1, 1], np.ones_like(x)], -1)
    world = local @ frame.viewmat[:3, :3]
    height = 0.5 + 0.5 * (world[..., 2:] / np.linalg.norm(world, axis=-1, keepdims=True))
    return 1 - share * (1 - ((1 - height) * HORIZON + height * ZENITH))


def _displaced(scene: Scene, turn: float, shift: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Viewmats by name: every camera turned about its centre and put elsewhere, at random; see `inject`."""
    import jax.numpy as jnp

    from gsjax.cameras import Camera, viewmat_center
    from gsjax.effects.twists import apply_twist, gauge

    frames = scene.frames
    depths = np.concatenate([scene.points @ f.viewmat[2, :3] + f.viewmat[2, 3] for f in frames])
    unit = float(np.median(depths[depths > 0]))
    twists = np.repeat([turn, shift], 3) * rng.normal(size=(len(frames), 6))
    trained = np.array([not frame.held_out for frame in frames])
    centers = np.stack([viewmat_center(f.viewmat) for f in frames])[trained]
    fixed, own = gauge(centers, unit), twists[trained].reshape(-1)
    twists[trained] = (own - fixed @ (fixed.T @ own)).reshape(-1, 6)
    cameras = [Camera(jnp.asarray(f.viewmat), jnp.asarray(f.K), f.width, f.height) for f in frames]
    wrong = [apply_twist(c, jnp.asarray(t, jnp.float32), unit).viewmat for c, t in zip(cameras, twists, strict=True)]
    return {frame.name: np.asarray(viewmat, np.float64) for frame, viewmat in zip(frames, wrong, strict=True)}


def main() -> None:
    """Reads the arguments and writes the data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", metavar="SCENE", help="folder of a data set with PNGs in images/")
    parser.add_argument("out", metavar="OUT", help="folder to make")
    for name in ("exposure", "balance", "corner"):
        parser.add_argument(f"--{name}", type=float, default=0.0, metavar="EV")
    parser.add_argument("--turn", type=float, default=0.0, metavar="DEGREES")
    parser.add_argument("--shift", type=float, default=0.0, metavar="SHARE")
    parser.add_argument("--sky", type=float, default=0.0, metavar="SHARE")
    parser.add_argument("--pasted", type=float, default=0.0, metavar="SHARE")
    parser.add_argument("--seed", type=int, default=0)
    arguments = vars(parser.parse_args())
    print(inject(arguments.pop("scene"), arguments.pop("out"), **arguments))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
