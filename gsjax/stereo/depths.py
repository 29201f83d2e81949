"""The depth of photos where they agree about it."""

from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from gsjax.rendering.shown_depths import ShownDepth
from gsjax.scene import Scene
from gsjax.scene.cameras import Camera
from gsjax.stereo.aggregation import best_planes
from gsjax.stereo.agreement import Evidence, confirmed, evidence, patches
from gsjax.stereo.sweep import dissimilarities, inverse_depths
from gsjax.stereo.views import MOST_VIEWS, Depth, View, neighbors, stereo_views

SURE = 0.6  # dissimilarity up to which a pixel may be sure


class PhotoDepth(NamedTuple):
    """What one photo tells."""

    view: View
    depth: Depth  # sure where another photo confirms it
    evidence: Evidence  # what the photo's matched points say of that

    def shown(self) -> ShownDepth:
        """The depth where it is sure, as what a view shows."""
        height, width = self.view.gray.shape
        camera = Camera(self.view.viewmat, self.view.K, width, height)  # pyright: ignore[reportArgumentType]
        return ShownDepth(camera, np.where(self.depth.is_sure, self.depth.z, 0).astype(np.float32))


class PhotoDepths(NamedTuple):
    """What photos tell."""

    told: tuple[PhotoDepth, ...]  # of the photos that are believed
    looked_at: int  # how many photos were compared

    @property
    def line(self) -> str:
        """How many photos are believed, and how right they are, in words."""
        right = sum(each.evidence.right for each in self.told)
        known = sum(each.evidence.told for each in self.told)
        share = f"; {right / known:.0%} of {known:,} matched points confirm their depth" if known else ""
        return f"{len(self.told)} of {self.looked_at} photos{share}"


def depths_of_photos(scene: Scene, most: int = MOST_VIEWS) -> PhotoDepths:
    """Depth of training photos, from each other, where it is more than chance.

    Every photo is swept by planes against its neighbours, smoothed, and kept where it is sure, where another photo
    confirms it, and unless its own matched points contradict it. Photos are compared at `gsjax.stereo.views.SIDE`.

    Args:
        scene: A loaded data set; without tracks no photo is compared.
        most: Photos that are compared; of more, some, evenly by name.

    Raises:
        InputError: The tracks cannot be read, or name points that the scene does not have.
    """
    views = stereo_views(scene, most)
    if len(views) < 2:
        return PhotoDepths((), len(views))
    near = neighbors(views, scene.points)
    swept = [
        _swept(view, [views[other] for other in others])
        for view, others in zip(tqdm(views, desc="stereo", unit="photo", leave=False), near, strict=True)
    ]
    told = []
    for index, (view, depth) in enumerate(zip(views, swept, strict=True)):
        others = sorted({*near[index], *(other for other, its in enumerate(near) if index in its)})
        kept = depth._replace(is_sure=confirmed(view, depth, [(views[other], swept[other]) for other in others]))
        said = evidence(view, kept, scene.points)
        if said.is_good and kept.is_sure.any():
            told.append(PhotoDepth(view, kept, said))
    return PhotoDepths(tuple(told), len(views))


def _swept(view: View, others: list[View]) -> Depth:
    if not others:
        return Depth(np.ones(view.gray.shape), np.zeros(view.gray.shape, bool))
    places, unlike = best_planes(dissimilarities(view, others))
    inverse = inverse_depths(view)
    z = 1 / (inverse[0] + places * (inverse[1] - inverse[0]))
    return Depth(z, patches(z, unlike < SURE))
