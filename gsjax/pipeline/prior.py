"""Where the normals of a run come from: a folder of maps, or the run's own smoothed depth."""

import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gsjax import gallery
from gsjax.cameras import Camera
from gsjax.gaussians import Gaussians
from gsjax.io.files import atomic_path
from gsjax.io.normals import normal_maps
from gsjax.normals.axes import apply_axes, detect_axes
from gsjax.normals.from_depth import depth_normals, smoothed_depth_normals
from gsjax.pipeline.result import BACKGROUNDS, frame_camera
from gsjax.scene import Frame
from gsjax.views import Views, with_normals

CLEAR_SCORE, CLEAR_MARGIN = 0.5, 0.02  # Below either, the axes of foreign maps are doubtful (method: A8).


class RunPrior:
    """The normals prior of a run, `[H, W, 3]` camera frame a view, kept in RUN/normals.npz once it is known.

    A resumed run reads that file, so that it goes on with the same numbers. That every map given by the user is there
    is checked when the run starts, not hours later.
    """

    def __init__(self, run: Path, folder: str | None, frames: tuple[Frame, ...]):
        self.file = run / "normals.npz"
        self.frames = frames
        self.given = None if folder is None else normal_maps(folder, frames)

    def __call__(self, gaussians: Gaussians, views: Views) -> Views:
        """Add normals to the views, made of the Gaussians so far where the user gave none."""
        if not self.file.exists():
            maps = self._maps(gaussians)
            with atomic_path(self.file) as temporary, open(temporary, "wb") as file:
                np.savez_compressed(file, **{str(i): m.astype(np.float16) for i, m in enumerate(maps)})
        with np.load(self.file) as stored:
            maps = [stored[str(i)] for i in range(len(self.frames))]
        return with_normals(views, maps)

    def _maps(self, gaussians: Gaussians) -> list[np.ndarray]:
        cameras = [frame_camera(f) for f in self.frames]
        rendered = list(gallery.pictures(gaussians, cameras, BACKGROUNDS["black"]))
        if self.given is None:
            return [_smoothed(p, c) for p, c in zip(rendered, cameras, strict=True)]
        maps = [self.given[f.name]() for f in self.frames]
        references = [
            np.asarray(depth_normals(jnp.asarray(p.depth), c)) for p, c in zip(rendered, cameras, strict=True)
        ]
        signs, score, margin = detect_axes(maps, references)
        names = "".join(f"{'+' if s > 0 else '-'}{axis}" for s, axis in zip(signs, "xyz", strict=True))
        doubt = "" if score >= CLEAR_SCORE and margin >= CLEAR_MARGIN else "; this is doubtful, check the maps' axes"
        print(
            f"normals: axes read as {names} (mean |cos| {score:.3f} against the rendered depth, next best {margin:.3f} "
            f"lower){doubt}",
            file=sys.stderr,
        )
        return [apply_axes(m, signs) for m in maps]


def _smoothed(picture: gallery.Picture, camera: Camera) -> np.ndarray:
    return np.asarray(smoothed_depth_normals(jnp.asarray(picture.depth), jnp.asarray(picture.alphas), camera))
