"""Where a training starts: from which points, and the state at step 0."""

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from gsjax.effects import sky
from gsjax.effects.simulation import Effects
from gsjax.io.ply import read_points
from gsjax.scene import Scene
from gsjax.settings import Model
from gsjax.stereo import PhotoDepths, stereo_points
from gsjax.training import initialize
from gsjax.training.buffers import bucket
from gsjax.training.densification.rules import DensificationRule
from gsjax.training.optimizers import Optimizer
from gsjax.training.plan import Plan
from gsjax.training.state import TrainState, initial_state

FAR_SHARE = 10  # Of the budget no more than one in so many is far around the cloud at the start.
CLOUD_SHARE = 2  # The budget divided by this bounds the points by stereo; nobody looks for any in a larger cloud.


def with_given_points(scene: Scene, file: str | None) -> Scene:
    """The scene with the points of a PLY, which only the start of training reads, and no tracks; None: as it is."""
    if file is None:
        return scene
    points, colors = read_points(file, least=2)
    local = scene.similarity.points_to_local(scene.place.points_to_world(points))
    return replace(scene, points=local, point_colors=colors, tracks=None)


def with_stereo_points(scene: Scene, planned: Plan, depths: Callable[[], PhotoDepths]) -> tuple[Scene, tuple[str, ...]]:
    """The scene with points of multi-view consistent depth after its own, and a line that reports how many.

    What structure from motion left empty has something to start with, on the surface and not before it. `depths`
    computes stereo depth of the photos, and is called only where points are added.
    """
    most = planned.max_gaussians // CLOUD_SHARE
    count = min(planned.stereo_points, most)
    if not count or scene.tracks is None or len(scene.points) > most:
        return scene, ()
    swept = depths()
    if not swept.accepted:
        return scene, (f"no points by stereo: {swept.fault}",) if swept.fault else ()
    added = stereo_points(swept, count)
    points = np.concatenate([scene.points, added.points])
    return replace(scene, points=points, point_colors=np.concatenate([scene.point_colors, added.colors])), (added.line,)


def starting_points(scene: Scene, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """The cloud and its colours, with grey points far around it unless what is behind all is laid there by us."""
    frames, count = scene.train_frames, min(model.far_points, model.max_gaussians // FAR_SHARE)
    if not count or model.background == "white" or any(frame.pixels().matte is not None for frame in frames):
        return scene.points, scene.point_colors
    far = initialize.far_points(scene.points, frames, count)
    # Of a cloud larger than the budget some stay out: the far ones must not be among them.
    room = min(model.max_gaussians - len(far), len(scene.points))
    indices = np.linspace(0, len(scene.points) - 1, room).astype(int)
    grey = np.full((len(far), 3), 128, np.uint8)
    return np.concatenate([scene.points[indices], far]), np.concatenate([scene.point_colors[indices], grey])


def first_state(
    scene: Scene,
    model: Model,
    rule: DensificationRule,
    optimizer: Optimizer,
    effects: Effects,
    rows: int | None = None,
    skies: sky.Masks = MappingProxyType({}),
) -> TrainState:
    """Step 0 in a buffer of so many rows; None: of those that the points take. No point is in the photos' sky."""
    points, colors = starting_points(scene, model)
    if skies:
        stay = ~sky.lies_in(points, scene.train_frames, skies)
        points, colors = points[stay], colors[stay]
    first = initialize.from_points(
        points,
        colors,
        capacity=rows or bucket(len(points), model.max_gaussians),
        sh_degree=model.sh_degree,
        pixel_filter=model.pixel_filter,
    )
    return initial_state(first, optimizer, rule, effects)
