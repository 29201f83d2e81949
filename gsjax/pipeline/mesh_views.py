"""The training views of a result, as mesh methods read them: each is rendered once, if memory allows."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gsjax.gaussians import take, without_view_dependence
from gsjax.io.machine import free_memory
from gsjax.meshing.tsdf import NormalsOfDepth
from gsjax.normals.from_depth import chosen_reduction, smoothed_depth_normals
from gsjax.rendering.coarse_depths import CoarseDepth, coarse_depth
from gsjax.rendering.gallery import Picture
from gsjax.rendering.outliers import are_floaters
from gsjax.runs.normal_source import VIEWS_FOR_NOISE
from gsjax.runs.result import Result, training_pictures
from gsjax.runs.viewpoints import evenly_spread
from gsjax.scene import Scene
from gsjax.scene.colors import to_bytes
from gsjax.stereo import StereoMap, depths_of_photos, read_stereo_maps, stereo_maps

MOST_COMPARED = 100  # photos, evenly spread: more of them add little
BYTES_PER_PIXEL = 15  # of a stored picture
STORED_SHARE = 0.5  # of the free memory: pictures that take more are rendered again instead


class MeshViews:
    """What the training views show, each thing computed once, when a method reads it."""

    def __init__(self, result: Result, data: Scene | None, *, with_owners: bool):
        """Of a result and its data set, None where its photos are gone; with the owners of pixels or without."""
        self.result, self.data, self.with_owners = result, data, with_owners
        self.training = [index for index, held_out in enumerate(result.held_out) if not held_out]
        self.cameras = [result.cameras[index] for index in self.training]
        self.ids: Sequence[int] = range(len(self.training))

    def pictures(self, ids: Sequence[int] | None = None) -> Iterator[Picture]:
        """Return what the Gaussians show, in their constant colour, to the views of some indices. None: to all."""
        ids = self.ids if ids is None else ids
        if not self._are_stored:
            return self._rendered(ids)
        stored = (self._stored[index] for index in ids)
        return (picture._replace(colors=picture.colors.astype(np.float32) / 255) for picture in stored)

    def spread(self, most: int) -> Sequence[int]:
        """Return the indices of at most so many views, evenly spread."""
        return evenly_spread(len(self.ids), most)

    def without_floaters(self) -> tuple["MeshViews", int]:
        """Return the views of the Gaussians that do not hang in the air, and how many do."""
        hang = are_floaters(self.result.gaussians, self.rendered)
        if not hang.any():
            return self, 0
        result = replace(self.result, gaussians=take(self.result.gaussians, ~hang))
        return MeshViews(result, self.data, with_owners=self.with_owners), int(hang.sum())

    @cached_property
    def rendered(self) -> list[CoarseDepth]:
        """The coarse rendered depth of every training view."""
        pictures = self.pictures() if self._are_stored else self._rendered(self.ids, with_owners=False)
        return list(map(coarse_depth, self.cameras, pictures))

    @cached_property
    def stereo(self) -> dict[int, np.ndarray]:
        """By the view's index, the multi-view stereo depth of its photo: that which supervised the run, if any did."""
        maps = self._of_run
        if maps is None:
            if self.data is None:
                return {}
            depths = depths_of_photos(self.data, MOST_COMPARED)
            print(f"mesh: multi-view consistent depth: {depths.line}", file=sys.stderr)
            maps = stereo_maps(depths)
        numbers = {self.result.names[index]: number for number, index in enumerate(self.training)}
        return {numbers[name]: each.depth for name, each in maps.items() if name in numbers}

    @property
    def stereo_counts(self) -> bool:
        """Whether stereo depth counts where the rendered depth contradicts it: the Gaussians were trained without."""
        return self._of_run is None

    @cached_property
    def _of_run(self) -> dict[str, StereoMap] | None:
        source = Path(self.result.source)
        return read_stereo_maps(source) if source.is_dir() else None

    @cached_property
    def normals_of(self) -> NormalsOfDepth:
        """Normals of depth in windows that fit the noise of the rendered depth."""
        ids = self.spread(VIEWS_FOR_NOISE)
        views = (
            (jnp.asarray(picture.depth), jnp.asarray(picture.alphas), self.cameras[index])
            for index, picture in zip(ids, self.pictures(ids), strict=True)
        )
        return partial(smoothed_depth_normals, reduction=chosen_reduction(views))

    @cached_property
    def _are_stored(self) -> bool:
        pixels = sum(camera.width * camera.height for camera in self.cameras)
        return BYTES_PER_PIXEL * pixels < STORED_SHARE * free_memory()

    @cached_property
    def _stored(self) -> list[Picture]:
        """All pictures, their colours as bytes."""
        return [picture._replace(colors=to_bytes(picture.colors)) for picture in self._rendered(self.ids)]

    def _rendered(self, ids: Sequence[int], *, with_owners: bool | None = None) -> Iterator[Picture]:
        indices = {self.training[index] for index in ids}
        others = tuple(index not in indices for index in range(len(self.result.held_out)))
        return training_pictures(
            replace(self.result, held_out=others),
            without_view_dependence(self.result.gaussians),
            self.result.background,
            with_owners=self.with_owners if with_owners is None else with_owners,
        )[1]
