"""The training views of a result, as mesh methods read them."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial

from gsjax.cameras import Camera
from gsjax.gaussians import take, without_view_dependence
from gsjax.meshing.depth_points import NormalsOfDepth
from gsjax.normals.from_depth import smoothed_depth_normals
from gsjax.rendering.floaters import are_floaters
from gsjax.rendering.gallery import Picture
from gsjax.rendering.shown_depths import ShownDepth, coarse_depth
from gsjax.runs.prior import reduction_for
from gsjax.runs.result import Result, training_pictures
from gsjax.scene import Scene
from gsjax.stereo import depths_of_photos

MOST_COMPARED = 100  # photos, evenly spread: more of them add little


class MeshViews:
    """What the training views show, each computed once, when a method reads it."""

    def __init__(self, result: Result, data: Scene | None, *, with_owners: bool):
        """Render nothing yet.

        Args:
            result: Whose training views.
            data: Its data set. None: its photos are not available.
            with_owners: Whether pictures have owners.
        """
        self.result, self.data, self.with_owners = result, data, with_owners
        self.ids: Sequence[int] = range(len(result.held_out) - sum(result.held_out))

    def pictures(self) -> tuple[list[Camera], Iterator[Picture]]:
        """Return the training cameras, and the Gaussians in their constant colour as each shows them."""
        return pictures_of(self.result, with_owners=self.with_owners)

    @cached_property
    def shown(self) -> list[ShownDepth]:
        """The coarse rendered depth of every training view."""
        return list(map(coarse_depth, *pictures_of(self.result, with_owners=False)))

    @cached_property
    def told(self) -> dict[int, ShownDepth]:
        """By the view's index, the multi-view stereo depth of its photo."""
        if self.data is None:
            return {}
        every = zip(self.result.names, self.result.held_out, strict=True)
        names = [name for name, held_out in every if not held_out]
        depths = depths_of_photos(self.data, MOST_COMPARED)
        print(f"mesh: depth that photos agree about: {depths.line}", file=sys.stderr)
        return {names.index(each.view.name): each.shown() for each in depths.told}

    @cached_property
    def normals_of(self) -> NormalsOfDepth:
        """Normals of depth in windows that fit the noise of the run's depth."""
        cameras, _ = pictures_of(self.result, with_owners=False)
        reduction = reduction_for(self.result.gaussians, cameras, self.result.depth_mode)
        return partial(smoothed_depth_normals, reduction=reduction)


def without_floaters(result: Result) -> tuple[Result, int]:
    """Return the result without the Gaussians that hang in the air, and how many those were."""
    hang = are_floaters(result.gaussians, map(coarse_depth, *pictures_of(result, with_owners=False)))
    return replace(result, gaussians=take(result.gaussians, ~hang)), int(hang.sum())


def pictures_of(result: Result, *, with_owners: bool) -> tuple[list[Camera], Iterator[Picture]]:
    """Return the training cameras, and the Gaussians in their constant colour as each shows them."""
    plain = without_view_dependence(result.gaussians)
    return training_pictures(result, plain, result.background, with_owners=with_owners)
