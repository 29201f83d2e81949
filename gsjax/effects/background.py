"""Open sky or a bare backdrop: light that comes from no surface."""

import numpy as np

from gsjax.effects.evidence import Evidence, unknown
from gsjax.effects.observations import Observations

THRESHOLD = 0.25  # of the photos
OPEN = 0.05  # of a photo's pixels
COST = "a constant colour: nothing; by direction: 900 bytes, one product a pixel"
_ONE_COLOR = 0.02  # standard deviation over the photos


def judge(seen: Observations) -> Evidence:
    """On where many photos show much that is bright and smooth, and where nothing was matched."""
    if any(facts.has_matte for facts in seen.facts):
        note = "mattes tell the object from what is behind it: --background random serves"
        return Evidence(False, 0.0, "share of photos", 0.0, THRESHOLD, COST, note)
    if not seen.tracked:
        return unknown("share of photos", THRESHOLD, COST, "without tracks a sky is no different from a wall")
    shares = np.array([facts.sky_share for facts in seen.facts])
    is_open = shares > OPEN
    value = float(is_open.mean())
    noise = float(np.sqrt(value * (1 - value) / len(shares)))
    note = f"{100 * shares.mean():.0f} % of all pixels bright, smooth and unmatched"
    if value > THRESHOLD:
        colors = np.stack([facts.sky_color for facts in seen.facts])[is_open]
        mean, spread = colors.mean(0), float(colors.std(0).max())
        shown = ", ".join(f"{channel:.2f}" for channel in mean)
        note += f"; colour {shown}, " + ("the same in all photos" if spread < _ONE_COLOR else f"+-{spread:.2f}")
        note += "; a bright wall looks the same: reported"
    return Evidence(value > THRESHOLD, value, "share of photos", noise, THRESHOLD, COST, note)
