"""How far off is what a run learned of an effect from what was put in? One measure an effect, `ERRORS`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from inject_effects import sky_color

from gsjax import runs
from gsjax.effects import transients, vignetting
from gsjax.io import json_files
from gsjax.render import backdrop, gallery
from gsjax.runs.checkpoints import load_arrays
from gsjax.runs.photography import read_photography
from gsjax.runs.result import frame_camera, open_result
from gsjax.scene import Scene

POINTS, SMALL = 300, 1e-4  # that stand for all; of a world's change, to first order
STOPS = 2.2 / np.log(2)  # of light, in a natural logarithm of display-coded values


class Truth(NamedTuple):
    """What an effect's error is told from."""

    clean: Scene  # as it was
    scene: Scene  # as training gets it
    told: dict[str, Any]  # what was put in, see `inject_effects.inject`
    run: Path


def of_gains(truth: Truth) -> float:
    """Root mean square over the photos that are trained on and their channels, EV."""
    names = [frame.name for frame in truth.scene.train_frames]
    true = np.array([truth.told["gains"][name] if truth.told else np.zeros(3) for name in names])
    looks = read_photography(truth.run).looks
    found = STOPS * np.array([looks[name].log_gains if looks else np.zeros(3) for name in names])
    return float(np.sqrt(np.square(found - true + true.mean(0)).mean()))


def of_corner(truth: Truth) -> float:
    """Light of a corner against the middle's, EV."""
    frame, looks = truth.scene.train_frames[0], read_photography(truth.run).looks
    found = 0.0
    if looks:
        camera = frame_camera(frame)
        falloff = np.asarray(vignetting.falloff(jnp.asarray(looks[frame.name].falloff, jnp.float32), camera))
        found = STOPS * float(falloff[0, 0])
    return abs(found - truth.told.get("corner", 0.0))


def of_cameras(truth: Truth) -> float:
    """How far points are from their true pixels in the training photos, pixels: root mean square.

    Without what the best small turn, shift and growth of the world explains, which is nobody's error.
    """
    true = {frame.name: (frame.viewmat, frame.K) for frame in truth.clean.train_frames}
    found = [record for record in json_files.read(truth.run / "cameras.json") if not record["held_out"]]
    rng = np.random.default_rng(0)
    points = truth.clean.points[rng.permutation(len(truth.clean.points))[:POINTS]].astype(np.float64)
    offsets = points - points.mean(0)
    worlds = [np.cross(axis, offsets) for axis in np.eye(3)] + [np.ones_like(points) * axis for axis in np.eye(3)]
    right = np.concatenate([pixels(points, *true[record["name"]]) for record in found])
    errors = np.concatenate([pixels(points, record["viewmat"], record["K"]) for record in found]) - right
    modes = [
        (np.concatenate([pixels(points + SMALL * w, *true[r["name"]]) for r in found]) - right) / SMALL
        for w in [*worlds, offsets]
    ]
    slopes = np.stack([mode.ravel() for mode in modes], -1)
    left = errors.ravel() - slopes @ np.linalg.lstsq(slopes, errors.ravel(), rcond=None)[0]
    return float(np.sqrt(np.square(left).reshape(-1, 2).sum(-1).mean()))


def of_sky(truth: Truth) -> float:
    """Mean difference of what is behind all from the sky, over the sky of the held-out photos, of 255."""
    result, share = open_result(truth.run), truth.told.get("sky", 0.0)
    found = []
    for frame in truth.clean.held_out_frames:
        behind = np.asarray(backdrop.color_behind(jnp.asarray(result.background, jnp.float32), frame_camera(frame)))
        is_sky = truth.clean.truth.labels[frame.name]() == 0  # pyright: ignore[reportOptionalMemberAccess]
        off = np.abs(np.broadcast_to(behind, (*is_sky.shape, 3)) - sky_color(frame, share))
        found.append(off[is_sky])
    return 255 * float(np.concatenate(found).mean())


def of_masks(truth: Truth) -> float:
    """Share of what was pasted in that is trusted, and of the rest that is not: the larger."""
    arrays = load_arrays(runs.latest_checkpoint(truth.run)[1])  # pyright: ignore[reportOptionalSubscript]
    threshold = arrays.get("['state'].effects.numbers['transients']")
    if threshold is None:
        return 1.0
    result, wrong = open_result(truth.run), {True: [], False: []}
    frames = truth.scene.train_frames
    drawn = gallery.pictures(result.gaussians, [frame_camera(f) for f in frames], result.background)
    for before, after, picture in zip(truth.clean.train_frames, frames, drawn, strict=True):
        photo = after.pixels().image
        pasted = (photo != before.pixels().image).any(-1)
        trusted = transients.trusted_pixels(
            jnp.asarray(threshold), picture.colors, jnp.asarray(photo, jnp.float32) / 255
        )
        for there, off in ((True, trusted), (False, ~trusted)):
            wrong[there].append(np.asarray(off)[pasted == there])
    return float(max(np.concatenate(each).mean() for each in wrong.values() if np.concatenate(each).size))


def pixels(points: np.ndarray, viewmat: Any, K: Any) -> np.ndarray:
    """`[P, 2]` places of points in a picture."""
    viewmat, K = np.asarray(viewmat, np.float64), np.asarray(K, np.float64)
    shown = (points @ viewmat[:3, :3].T + viewmat[:3, 3]) @ K.T
    return shown[:, :2] / shown[:, 2:]


ERRORS: dict[str, Callable[[Truth], float]] = {
    "exposure": of_gains,
    "vignetting": of_corner,
    "poses": of_cameras,
    "background": of_sky,
    "transients": of_masks,
}
"""By effect, in the unit of its row."""
