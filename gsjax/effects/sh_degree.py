"""View-dependent colour: points whose light changes with the direction that they are seen from."""

import numpy as np

from gsjax.cameras import viewmat_center
from gsjax.effects.evidence import Evidence, gaussian_cost, unknown
from gsjax.effects.exposure import Gains
from gsjax.effects.observations import Observations

THRESHOLD = 0.5  # of the variance within tracks; Lambertian patches give 0.3, since their foreshortening changes too
LAMBERTIAN = 0.3
LONGEST, SHORTEST = 24, 6  # observations of a point that are looked at; fewer cannot hold a slope
COST = gaussian_cost(6 * 45, 45, "what degree 3 has beyond degree 0")
_RIDGE = 1e-3


def explained_variance(seen: Observations, gains: Gains) -> float | None:
    """Share of the variance within tracks, left out in turn, that a linear function of the direction explains.

    Median squares, after gains; None where no track is long enough.
    """
    data = gains.data
    values = (data.values - gains.fit.gains[data.photo]).mean(1)
    centers = np.stack([viewmat_center(f.viewmat.astype(np.float64)) for f in seen.frames])
    towards = centers[data.photo] - seen.points[data.origins[data.point]]
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    order = np.argsort(data.point, kind="stable")
    starts = np.searchsorted(data.point[order], np.arange(len(data.origins)))
    place = np.arange(len(order)) - starts[data.point[order]]
    shown = place < LONGEST
    shape = (len(data.origins), LONGEST)
    rows, columns, order = data.point[order][shown], place[shown], order[shown]
    there, y, basis = np.zeros(shape), np.zeros(shape), np.zeros((*shape, 4))
    there[rows, columns], y[rows, columns] = 1, values[order]
    basis[rows, columns] = np.concatenate([np.ones((len(order), 1)), towards[order]], 1)
    long = there.sum(1) >= SHORTEST
    if not long.any():
        return None
    there, y, basis = there[long], y[long], basis[long]
    flat, sloped = (_left_out(there, y, basis[..., :size]) for size in (1, 4))
    return 1 - float(np.median(np.square(sloped)) / max(np.median(np.square(flat)), 1e-12))


def judge(seen: Observations, gains: Gains | None) -> Evidence:
    """On where direction explains more than foreshortening does."""
    share = None if gains is None else explained_variance(seen, gains)
    if share is None:
        return unknown("share of variance", THRESHOLD, COST, f"needs points that {SHORTEST} photos see")
    note = "colours change with direction" if share > THRESHOLD else "no more than patches of a matt surface do"
    note += "; --effects sh_degree lets photos that are kept from the colours choose it"
    return Evidence(share > THRESHOLD, share, "share of variance", LAMBERTIAN, THRESHOLD, COST, note)


def _left_out(there: np.ndarray, y: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Errors of every observation `[K, L]` predicted by the fit to the others of its track; those that are there."""
    gram = np.einsum("kla,klb->kab", basis, basis) + _RIDGE * np.eye(basis.shape[2])
    inverse = np.linalg.inv(gram)
    weights = np.einsum("kab,kla,kl->kb", inverse, basis, y)
    leverage = np.einsum("kla,kab,klb->kl", basis, inverse, basis)
    errors = (y - np.einsum("kla,ka->kl", basis, weights)) / np.maximum(1 - leverage, 1e-3)
    return errors[there > 0]
