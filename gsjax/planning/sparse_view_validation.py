"""Validation runs of sparse-view regularization: its gain on photos that short runs hold out, and on their depth."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from gsjax.metrics.images import in_decibels, mse
from gsjax.planning.sizes import training_extent
from gsjax.planning.sparse_views import Gain
from gsjax.planning.start import first_state, with_given_points, with_stereo_points
from gsjax.planning.validation import Observe, Variant, mean_and_error, short_settings
from gsjax.rendering import gallery
from gsjax.runs.result import BACKGROUND_COLORS
from gsjax.scene import Scene, batches, preload, tracks_by_name
from gsjax.scene.cameras import Camera, landing
from gsjax.settings import Model, Settings
from gsjax.stereo import PhotoDepths, depths_of_photos
from gsjax.training import optimizers
from gsjax.training.plan import Plan, plan

FOLDS = 4  # Each photo is held out in one pair of validation runs of so many.
FEWEST_FOLDS = 2  # After so many they end, if the gain is significant and depth does not contradict it.
FEWEST_POINTS = 20  # matched points, for the depth of a photo to be judged
LEAST_ERROR = 1e-6  # of depth, relative: its logarithm is taken


class Score(NamedTuple):
    """Score of a photo that a validation run held out."""

    psnr: float
    depth_error: float | None  # relative, median over matched points; None: they are too few


def gain(scene: Scene, settings: Settings, change: Callable[[Plan], Plan]) -> Gain:
    """The gain of a changed plan on photos that training has not seen: decibels, and the error of depth.

    Each fold trains `quick` in few steps on small photos, with the change and without, and scores the photos that it
    holds out. Depth is compared with that of the points that were matched in them. Deterministic. There must be five
    training photos; the scene's own held-out ones take no part. Points, seed, background and kind of Gaussians are
    those of the run's settings.

    Raises:
        InputError: A photo or the tracks cannot be read.
    """
    frames = tuple(map(preload, tqdm(scene.train_frames, desc="photos", unit="photo", leave=False)))
    matched = {name: scene.points[ids].astype(np.float64) for name, (ids, _) in tracks_by_name(scene).items()}
    scene = with_given_points(scene, settings.model.points)
    short = short_settings(settings, scene.train_frames, len(scene.points))
    planned, size = plan(short), training_extent(scene)
    optimizer = optimizers.make_optimizer(planned.rates, size, planned.steps)
    variants = [Variant(each, optimizer, size) for each in (planned, change(planned))]
    total, title = 2 * FOLDS * planned.steps, "validating sparse-view regularization"
    pairs: list[tuple[Score, Score]] = []
    with tqdm(total=total, desc=title, unit="step", leave=False) as bar:
        for fold in range(FOLDS):
            parted = tuple(replace(each, held_out=index % FOLDS == fold) for index, each in enumerate(frames))
            fold_scene = replace(scene, frames=parted)
            depths = cache(partial(depths_of_photos, fold_scene))
            scores = [score_variant(each, fold_scene, depths, short.model, matched, bar.update) for each in variants]
            pairs += zip(*scores, strict=True)
            so_far = _gain_of(pairs)
            if fold + 1 >= FEWEST_FOLDS and so_far.is_sure and not so_far.is_contradicted:
                break
    return so_far


def _gain_of(pairs: Sequence[tuple[Score, Score]]) -> Gain:
    """The gain over photos from their scores without the change and with it."""
    decibels = [changed.psnr - plain.psnr for plain, changed in pairs]
    errors = [(a.depth_error, b.depth_error) for a, b in pairs]
    ratios = [np.log(b / a) for a, b in errors if a is not None and b is not None]
    return Gain(*mean_and_error(decibels), *(mean_and_error(ratios) if len(ratios) > 1 else ()))


def score_variant(
    variant: Variant,
    scene: Scene,
    depths: Callable[[], PhotoDepths],
    model: Model,
    matched: Mapping[str, np.ndarray],
    observe: Observe,
) -> list[Score]:
    """Scores of a scene's held-out photos after a validation run on the others.

    `depths` computes stereo depth of those that are trained on; `matched` has `[P, 3]` points by the photo's name.
    """
    started, _ = with_stereo_points(scene, variant.plan, depths)
    model = replace(model, max_gaussians=variant.plan.max_gaussians)
    state = first_state(started, model, variant.plan.rule, variant.optimizer, {}, rows=model.max_gaussians)
    state = variant.train(scene.train_frames, state, observe)
    photos = batches.read_batches(scene.held_out_frames, scale=variant.plan.phases[0].scale).views
    color = BACKGROUND_COLORS[model.background]
    pictures = gallery.pictures(state.gaussians, [photo.camera for photo in photos], color, model.depth_mode)
    scores = []
    for frame, photo, picture in zip(scene.held_out_frames, photos, pictures, strict=True):
        batch = batches.decode(photo, jnp.asarray(color, jnp.float32))
        # A mask that leaves no pixel gives the highest PSNR to both variants.
        psnr = float(in_decibels(mse(jnp.asarray(picture.colors), batch.image, batch.valid)))
        points = matched.get(frame.name, np.zeros((0, 3)))
        scores.append(Score(psnr, depth_error(picture.depth, np.asarray(batch.valid), photo.camera, points)))
    return scores


def depth_error(depth: np.ndarray, valid: np.ndarray, camera: Camera, points: np.ndarray) -> float | None:
    """Median of |z / z of the point - 1| over the points `[P, 3]` at `valid` pixels of a rendered depth `[H, W]`.

    None where these are fewer than `FEWEST_POINTS`.
    """
    row, column, z, inside = landing(points, camera.viewmat, camera.K, depth.shape)
    counted = inside & valid[row, column]
    if counted.sum() < FEWEST_POINTS:
        return None
    return max(float(np.median(np.abs(depth[row, column][counted] / z[counted] - 1))), LEAST_ERROR)
