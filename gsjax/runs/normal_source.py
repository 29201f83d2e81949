"""The normals that supervise a run: a folder of maps, those of multi-view stereo, or of its own smoothed depth."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.io import json_files
from gsjax.io.images import cv2, read_image, write_image
from gsjax.io.normal_folders import network_of
from gsjax.io.normal_maps import map_places, normal_maps
from gsjax.normals.axes import apply_axes, axis_signs, detect_axes, written_axes
from gsjax.normals.consistency import share_compared
from gsjax.normals.from_depth import chosen_reduction, depth_normals, smoothed_depth_normals
from gsjax.rendering import DepthReading, gallery
from gsjax.runs import update_manifest
from gsjax.runs.normal_filter import filter_normals, stored_disagreements
from gsjax.runs.result import BACKGROUND_COLORS, frame_camera
from gsjax.runs.viewpoints import evenly_spread
from gsjax.scene import Frame, Keep, in_memory
from gsjax.scene.cameras import Camera
from gsjax.stereo import witnessed_normals

CLEAR_SCORE, CLEAR_MARGIN = 0.5, 0.02  # Below either, the axes of foreign maps are doubtful (method: A8).
VIEWS_FOR_AXES = 50  # as many as are compared with their maps, 4,000 pixels each
VIEWS_FOR_NOISE = 4


class NormalSource:
    """The normals of a run, one map a view, kept in RUN/normals as 8-bit pictures once it is known.

    A resumed run reads the stored maps and makes the missing ones, so its numbers are the same. Maps of the user are
    checked when the run starts. Besides the maps, at 3 bytes a pixel, one view at a time is in memory.
    """

    def __init__(
        self,
        run: Path,
        folder: str | None,
        axes: str | None,
        frames: tuple[Frame, ...],
        depth_mode: DepthReading = "plane",
        gated: bool = False,
        *,
        stereo: Mapping[str, np.ndarray] = MappingProxyType({}),
        keep: Keep = in_memory,
        notify: Callable[[str], None] = lambda line: tqdm.write(f"normals: {line}", file=sys.stderr),
    ):
        """Check what was given.

        Args:
            run: The run's folder, which need not exist yet.
            folder: Of foreign normal maps; None: the Gaussians' own.
            axes: Those of the foreign maps, see `axis_signs`; None: those that they were written with where `gsjax
                normals` made them, else found by comparing with the Gaussians.
            frames: Whose normals supervise the run.
            depth_mode: What the Gaussians' depth is, see `gsjax.rendering`.
            gated: Whether the consistency filter weights the normals, see `gsjax.runs.normal_filter`.
            stereo: Normals of multi-view stereo by the photo's name, `[h, w, 3]` int8 as `__call__` returns them. They
                serve where no folder is given, unfiltered: other photos confirm them already. Of a folder, they serve
                for the photos whose maps the filter rejects (`gsjax.stereo.witnessed_normals`).
            keep: Where the maps are to be.
            notify: Receives lines: the axes of foreign maps and the evidence for them; the verdict of the filter.

        Raises:
            InputError: A map is missing, or the axes are none.
        """
        self.folder = run / "normals"
        self.signs = None if axes is None else axis_signs(axes)
        if folder is None and axes is not None:
            raise InputError(f"normal_axes={axes}: there are no maps whose axes these are (supervision.normals)")
        self.depth_mode: DepthReading = depth_mode
        self.stereo = stereo
        self.gated = gated and (folder is not None or not stereo)
        self.keep, self.notify = keep, notify
        self.network = None if folder is None else network_of(folder)
        self.given = None if folder is None else normal_maps(folder, frames)

    def __call__(self, gaussians: Gaussians, frames: tuple[Frame, ...]) -> list[np.ndarray]:
        """The maps, made of the Gaussians so far where the user gave none.

        Returns:
            `[H, W, 3]` int8 a frame: 127 times the unit normal in the camera frame, times the filter's confidence; zero
            where there is none.

        Raises:
            InputError: A map is damaged, or cannot be written.
        """
        files = {name: self.folder / f"{place}.png" for name, place in map_places(frames).items()}
        missing = [frame for frame in frames if not files[frame.name].exists()]
        if missing:
            maps = self._new_maps(gaussians, frames, missing)
            bar = tqdm(zip(missing, maps, strict=True), total=len(missing), desc="normals", unit="view")
            for frame, normals in bar:
                write_map(files[frame.name], normals)
        read = [self.keep(read_map(files[frame.name], frame)) for frame in frames]
        if not self.gated:
            return read

        def notify(line: str) -> None:
            line += "; rejected photos take stereo normals" if self.stereo else ""
            share = float(np.mean(self.shares_compared(frames)))
            self.notify(line if share == 1 else f"{line}; {share:.0%} of the comparisons of neighbours are made")

        weighted = filter_normals(self.folder, gaussians, frames, read, self.depth_mode, keep=self.keep, notify=notify)
        return list(map(self._unless_rejected, frames, read, weighted))

    def _unless_rejected(self, frame: Frame, normals: np.ndarray, weighted: np.ndarray) -> np.ndarray:
        """The weighted map of a photo; of a photo that is rejected stereo normals, and what these confirm."""
        stereo = self.stereo.get(frame.name)
        if stereo is None or weighted.any():
            return weighted
        return self.keep(witnessed_normals(normals, stereo, frame.pixels().image))

    def shares_compared(self, frames: Sequence[Frame]) -> np.ndarray:
        """`[V]` in what share of its steps each photo is compared with a neighbour, once there are maps.

        Disagreement of self-supervised normals is disagreement about the surface. For maps of a network, and without
        the filter, all steps compare.
        """
        if not self.gated or self.given is not None:
            return np.ones(len(frames))
        return np.array([share_compared(apart) for apart in stored_disagreements(self.folder, frames)])

    def _new_maps(
        self, gaussians: Gaussians, frames: Sequence[Frame], missing: Sequence[Frame]
    ) -> Iterator[np.ndarray]:
        """The maps of the missing frames: of the folder, of stereo, or of the Gaussians' smoothed depth."""
        if self.given is not None:
            signs = self._axis_signs(gaussians, frames) if self.signs is None else self.signs
            for frame in missing:
                yield apply_axes(self.given[frame.name](), signs)
        elif self.stereo:
            yield from map(self._of_stereo, missing)
        else:
            reduction = reduction_for(gaussians, [frame_camera(frame) for frame in frames], self.depth_mode)
            for depth, alphas, camera in self._rendered(gaussians, missing):
                yield np.asarray(smoothed_depth_normals(depth, alphas, camera, reduction=reduction))

    def _of_stereo(self, frame: Frame) -> np.ndarray:
        normals = self.stereo.get(frame.name)
        if normals is None:
            return np.zeros((frame.height, frame.width, 3), np.float32)
        return (
            cv2.resize(normals, (frame.width, frame.height), interpolation=cv2.INTER_NEAREST).astype(np.float32) / 127
        )

    def _axis_signs(self, gaussians: Gaussians, frames: Sequence[Frame]) -> np.ndarray:
        """Signs of the axes: the convention's where the views do not decide, or a network's record sets them.

        One line reports them and the comparison.
        """
        assert self.given is not None
        some = [frames[index] for index in evenly_spread(len(frames), VIEWS_FOR_AXES)]
        maps = (self.given[frame.name]() for frame in some)
        references = (np.asarray(depth_normals(depth, camera)) for depth, _, camera in self._rendered(gaussians, some))
        signs, score, margin = detect_axes(maps, references)
        measured = f"mean cosine {score:.3f} against the rendered depth, next best {margin:.3f} lower"
        clear = score >= CLEAR_SCORE and margin >= CLEAR_MARGIN
        guess, ours = written_axes(signs), np.ones(3, np.float32)
        if clear and self.network is None:
            line = f"axes read as {guess} ({measured})"
        elif clear and np.array_equal(signs, ours):
            line = f"axes confirmed as in {self.network}'s record ({measured})"
        else:
            own, fault = self.network is None, "fits better" if clear else "is doubtful"
            decision = f"taken as {written_axes(ours)}" if own else f"kept as in {self.network}'s record"
            line, signs = f"axes {decision}: {guess} {fault} ({measured}); supervision.normal_axes sets them", ours
        self.notify(line)
        return signs

    def _rendered(self, gaussians: Gaussians, frames: Sequence[Frame]) -> Iterator[tuple]:
        """Depth, alphas and camera of one frame after the other."""
        return _views(gaussians, [frame_camera(frame) for frame in frames], self.depth_mode)


def note_normals(run: str | Path, line: str) -> None:
    """Print a line about the normal maps, and append it to the run's manifest."""
    tqdm.write(f"normals: {line}", file=sys.stderr)
    before = json_files.read(Path(run) / "manifest.json", {}).get("normals")
    update_manifest(run, normals=f"{before}; {line}" if before else line)


def reduction_for(gaussians: Gaussians, cameras: Sequence[Camera], depth_mode: DepthReading) -> int:
    """The `reduction` of `smoothed_depth_normals` for Gaussians, by the noise of some views."""
    some = [cameras[index] for index in evenly_spread(len(cameras), VIEWS_FOR_NOISE)]
    return chosen_reduction(_views(gaussians, some, depth_mode))


def _views(gaussians: Gaussians, cameras: Sequence[Camera], depth_mode: DepthReading) -> Iterator[tuple]:
    """Depth, alphas and camera of one view after the other."""
    pictures = gallery.pictures(gaussians, cameras, BACKGROUND_COLORS["black"], depth_mode)
    for picture, camera in zip(pictures, cameras, strict=True):
        yield jnp.asarray(picture.depth), jnp.asarray(picture.alphas), camera


def write_map(file: Path, normals: np.ndarray) -> None:
    """Writes `[H, W, 3]` unit normals as an 8-bit PNG, 128 + 127 n: zero is exactly middle grey."""
    write_image(file, (np.rint(127 * normals) + 128).astype(np.uint8))


def read_map(file: Path, frame: Frame) -> np.ndarray:
    """`[H, W, 3]` int8, 127 times what `write_map` was given; InputError of a file that is not of the frame's size."""
    pixels, _ = read_image(file)
    if pixels.shape[:2] != (frame.height, frame.width):
        size = f"{pixels.shape[1]}x{pixels.shape[0]}"
        raise InputError(f"{file}: normal map is {size}, its frame {frame.width}x{frame.height}")
    return (pixels ^ np.uint8(128)).view(np.int8)  # value - 128, without leaving 8 bits
