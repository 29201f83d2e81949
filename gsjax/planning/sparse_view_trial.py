"""Short trials on photos kept from them: does holding training back help the views between photos, and their depth?"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from gsjax.gaussians import Gaussians
from gsjax.metrics.images import in_decibels, mse
from gsjax.planning.sizes import training_extent
from gsjax.planning.sparse_views import Gain
from gsjax.planning.start import first_state, with_given_points, with_stereo_points
from gsjax.planning.validation import Observe, Variant, mean_and_error, short_settings
from gsjax.rendering import gallery
from gsjax.runs.result import BACKGROUND_COLORS
from gsjax.scene import Scene, batches, preload, tracks_by_name
from gsjax.scene.batches import Batches
from gsjax.scene.cameras import Camera, landing
from gsjax.settings import Settings
from gsjax.training import optimizers
from gsjax.training.plan import Plan, plan

FOLDS = 4  # Every photo is held out from one pair of validation runs in so many,
FEWEST_FOLDS = 2  # and after so many they end, where the gain is sure and depth does not contradict it.
FEWEST_POINTS = 20  # matched ones that a held-out photo's depth is judged by
LEAST_OFF = 1e-6  # share of its distance that depth is taken to be off by at least: a logarithm is taken of it


class Score(NamedTuple):
    """Of a photo that was kept from a trial."""

    psnr: float
    off: float | None  # share of their distance that matched points' depth is off by, median; None: too few are there


def gain(scene: Scene, settings: Settings, held_back: Callable[[Plan], Plan]) -> Gain:
    """What holding back brings photos that training has not seen: decibels, and how far depth is off.

    `quick` in few steps on small photos, from the beginning, as it is and held back, each time without some of the
    photos, which are then scored. Depth is compared with that of the points that were matched in them. Deterministic.

    Args:
        scene: The data set, five photos to train on at least. Held-out ones play no part.
        settings: The run. Trials begin from its points, and have its seed, background and kind of Gaussians.
        held_back: The plan of a trial -> the same held back.

    Raises:
        InputError: A photo or the tracks cannot be read.
    """
    frames = tuple(map(preload, tqdm(scene.train_frames, desc="photos", unit="photo", leave=False)))
    matched = {name: scene.points[ids].astype(np.float64) for name, (ids, _) in tracks_by_name(scene).items()}
    scene = with_given_points(scene, settings.model.points)
    short = short_settings(settings, scene.train_frames, len(scene.points))
    planned = plan(short)
    size = training_extent(scene)
    optimizer = optimizers.make_optimizer(planned.rates, size, planned.steps)
    variants = [Variant(each, optimizer, size) for each in (planned, held_back(planned))]
    pairs: list[tuple[Score, Score]] = []
    with tqdm(
        total=2 * FOLDS * planned.steps, desc="validating sparse-view regularization", unit="step", leave=False
    ) as bar:
        for fold in range(FOLDS):
            parted = [replace(each, held_out=index % FOLDS == fold) for index, each in enumerate(frames)]
            fold_scene = replace(scene, frames=tuple(parted))
            as_it_is, held = (
                _scored(
                    each,
                    fold_scene,
                    short.replace(model={"max_gaussians": each.plan.max_gaussians}),
                    matched,
                    bar.update,
                )
                for each in variants
            )
            pairs += zip(as_it_is, held, strict=True)
            found = _found(pairs)
            if fold + 1 >= FEWEST_FOLDS and found.is_sure and not found.is_contradicted:
                break
    return found


def _found(pairs: list[tuple[Score, Score]]) -> Gain:
    """Of the scores of photos, as it is and held back."""
    gains = [held.psnr - as_it_is.psnr for as_it_is, held in pairs]
    told = [(a.off, b.off) for a, b in pairs if a.off is not None and b.off is not None]
    return Gain(*mean_and_error(gains), *(mean_and_error([np.log(b / a) for a, b in told]) if len(told) > 1 else ()))


def _scored(
    variant: Variant, scene: Scene, settings: Settings, matched: Mapping[str, np.ndarray], observe: Observe
) -> list[Score]:
    """Scores of a scene's held-out photos after a validation run on the others; `matched`: name -> `[P, 3]` points."""
    started, _ = with_stereo_points(scene, variant.plan)
    state = first_state(
        started, settings.model, variant.plan.rule, variant.optimizer, {}, rows=settings.model.max_gaussians
    )
    state = variant.train(scene.train_frames, state, observe)
    photos = batches.read_batches(scene.held_out_frames, scale=variant.plan.phases[0].scale)
    points = [matched.get(frame.name, np.zeros((0, 3))) for frame in scene.held_out_frames]
    return _scores(state.gaussians, photos, points, settings)


def _scores(gaussians: Gaussians, photos: Batches, points: Sequence[np.ndarray], settings: Settings) -> list[Score]:
    """Of every photo, by its matched points `[P, 3]`. If a mask leaves nothing, PSNR is the highest, either way."""
    color = BACKGROUND_COLORS[settings.model.background]
    cameras = [each.camera for each in photos.views]
    shown = list(gallery.pictures(gaussians, cameras, color, settings.model.depth_mode))
    compared = [batches.decode(each, jnp.asarray(color, jnp.float32)) for each in photos.views]
    pairs = zip(shown, compared, strict=True)
    errors = [mse(jnp.asarray(picture.colors), batch.image, batch.valid) for picture, batch in pairs]
    psnr = np.asarray(in_decibels(jnp.stack(errors)), np.float64)
    seen = zip(shown, compared, cameras, points, strict=True)
    offs = [_off(picture.depth, np.asarray(batch.valid), camera, known) for picture, batch, camera, known in seen]
    return [Score(float(decibels), off) for decibels, off in zip(psnr, offs, strict=True)]


def _off(depth: np.ndarray, valid: np.ndarray, camera: Camera, points: np.ndarray) -> float | None:
    """Median of |z / z of the point - 1| over the points `[P, 3]` at `valid` pixels of a rendered depth `[H, W]`."""
    row, column, z, inside = landing(points, camera.viewmat, camera.K, depth.shape)
    counts = inside & valid[row, column]
    if counts.sum() < FEWEST_POINTS:
        return None
    return max(float(np.median(np.abs(depth[row, column][counts] / z[counts] - 1))), LEAST_OFF)
