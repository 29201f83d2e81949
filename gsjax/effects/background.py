"""Open sky or a bare backdrop: light that comes from no surface, and so from no Gaussian."""

from collections.abc import Sequence
from types import MappingProxyType

import numpy as np
import optax

from gsjax.effects import parallax, sky
from gsjax.effects.kinds import EffectKind, Evidence, Findings, Masks, Rate, StartInputs, unknown
from gsjax.effects.observations import Observations
from gsjax.effects.simulation import Effect
from gsjax.rendering import backdrop
from gsjax.scene import Frame

THRESHOLD = 0.25  # of the photos
OPEN = 0.05  # of a photo's pixels
DEGREE = 4  # of the spherical harmonics of a sky
RATE = 5e-3  # Adam's learning rate of the coefficients; they wait for nothing
SKIES_READ, PIXELS_READ = 60, 1000  # photos with sky, and pixels of each, that its colours are told by
_WHITE, _MOSTLY = 254.5, 0.9  # of every channel, of 255; of the places
_ONE_COLOR = 0.02  # standard deviation over the photos, and within them


def judge(findings: Findings) -> Evidence:
    """Judge whether light comes from no surface: much is bright, smooth and unmatched, and no wall explains it."""
    observations = findings.observations
    if any(facts.has_matte for facts in observations.facts):
        note = "the photos have mattes, for which model.background=random serves"
        return Evidence(False, 0.0, "share of photos", 0.0, THRESHOLD, note)
    if not observations.tracked:
        return unknown("share of photos", THRESHOLD, "without tracks a sky is no different from a wall")
    shares = np.array([facts.sky_share for facts in observations.facts])
    is_open = shares > OPEN
    value = float(is_open.mean())
    noise = float(np.sqrt(value * (1 - value) / len(shares)))
    note = f"{100 * shares.mean():.0f} % of all pixels bright, smooth and unmatched"
    if value <= THRESHOLD:
        return Evidence(False, value, "share of photos", noise, THRESHOLD, note)
    colors = np.stack([facts.sky_color for facts in observations.facts])[is_open]
    mean, spread = colors.mean(0), float(colors.std(0).max())
    channels = ", ".join(f"{channel:.2f}" for channel in mean)
    note += f"; colour {channels}, " + ("the same in all photos" if spread < _ONE_COLOR else f"+-{spread:.2f}")
    is_white = _is_white(observations)
    compared = findings.of_masks
    if not sky.judge(findings).on:
        compared = parallax.compare(observations, _bare_regions(observations), findings.gains)
    far = 0.0 if compared is None else sky.score(compared)
    note += "; pure white" if is_white else f"; a wall explains it x{far:.2f} as badly as infinity"
    is_on = is_white or far > sky.THRESHOLD
    note += "" if is_on else f", needs {sky.THRESHOLD}: off"
    # Gaussians that paint pure white are before the cameras of other photos, which validation runs do not show.
    return Evidence(is_on, value, "share of photos", noise, THRESHOLD, note, is_certain=is_white)


def _bare_regions(observations: Observations) -> dict[int, np.ndarray]:
    """Index of a photo -> `[h, w]` bool on the grid of `PhotoFacts.light`: what is bright, smooth and unmatched."""
    if _is_white(observations):
        return {}  # decided without
    return {index: facts.bare for index, facts in enumerate(observations.facts) if facts.sky_share > OPEN}


def _is_white(observations: Observations) -> bool:
    """Whether what is bare is pure white: made by a computer, or clipped, and no photo of plaster."""
    bare = [facts.light[facts.bare] for facts in observations.facts if facts.sky_share > OPEN]
    return bool(bare) and bool((np.concatenate(bare) > _WHITE).all(-1).mean() > _MOSTLY)


def initial(observations: Observations, skies: Masks = MappingProxyType({})) -> np.ndarray:
    """`[(L + 1)^2, 3]` SH coefficients to start with: the colours of the sky, the mean of what looks like it, or grey.

    L is 0 where what looks like sky has one colour, or nothing does; else `DEGREE`.
    """
    if any(frame.name in skies and not frame.held_out for frame in observations.frames):
        return _seen_through(observations.frames, skies)
    is_open = [facts for facts in observations.facts if facts.sky_share > OPEN]
    if not is_open:
        return backdrop.constant_coefficients(np.full(3, 0.5), 0)
    colors = np.stack([facts.sky_color for facts in is_open])
    spread = np.hypot(colors.std(0).max(), np.mean([facts.sky_spread for facts in is_open]))
    return backdrop.constant_coefficients(colors.mean(0), 0 if spread < _ONE_COLOR else DEGREE)


def _seen_through(frames: Sequence[Frame], skies: Masks) -> np.ndarray:
    """Coefficients of the sky's colours by direction, from some pixels of some photos that are trained on."""
    with_sky = [frame for frame in frames if frame.name in skies and not frame.held_out]
    directions, colors = [], []
    for frame in with_sky[:: -(-len(with_sky) // SKIES_READ)]:
        rows, columns = np.nonzero(skies[frame.name])
        indices = np.unique(np.linspace(0, len(rows) - 1, PIXELS_READ).astype(int))
        rows, columns = rows[indices], columns[indices]
        places = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], -1)
        directions.append(places @ np.linalg.inv(frame.K.astype(np.float64)).T @ frame.viewmat[:3, :3])
        colors.append(frame.pixels().image[rows, columns] / 255.0)
    return backdrop.fitted_coefficients(np.concatenate(directions), np.concatenate(colors), DEGREE)


def is_one(observations: Observations, color: float, most: np.ndarray, least: np.ndarray) -> bool:
    """Whether what looks like sky may all be of one grey, as the cameras show it: laid under renders, it is enough.

    `most` and `least` are `[V, 3]`, what a photo multiplies display-coded light by; 1 where nothing is known.
    """
    is_open = np.array([facts.sky_share > OPEN for facts in observations.facts])
    if not is_open.any():
        return False
    skies = np.stack([facts.sky_color for facts in observations.facts])[is_open]
    spread = np.array([facts.sky_spread for facts in observations.facts])[is_open].mean()
    lightest, darkest = (np.minimum(1.0, color * factor[is_open]) for factor in (most, least))
    beyond = np.maximum(np.maximum(skies - lightest, darkest - skies), 0)
    off = np.hypot(np.sqrt(np.square(beyond).mean(0)).max(), max(spread - (lightest - darkest).mean(), 0))
    return bool(off < _ONE_COLOR)


def simulate(inputs: StartInputs, rate: Rate) -> Effect:
    """The effect of a run, from the colours of what looks like sky."""
    effect = make_effect(initial(inputs.observations, inputs.skies), rate(peak=RATE, hold=0))
    return effect._replace(report=lambda numbers: {"background": np.asarray(numbers)})


def make_effect(coefficients: np.ndarray, rate: optax.Schedule) -> Effect:
    """A colour by direction is behind all Gaussians, see `gsjax.rendering.backdrop`. No surface is made of it."""
    return Effect(np.asarray(coefficients, np.float32), rate, behind=backdrop.color_behind)


EFFECT = EffectKind(judge, simulate, is_needless=is_one)
