"""When R at the pixels acts: in which part of the surface phase's time, in how many of its steps, with what weight.

All else, depth in front and the time among it, is as in `baselines_front.py`; the rest of the phase is plain.
"""

from studies.baselines import TERMS, Term, at_equal_time
from studies.baselines_front import COSTS

from gsjax.settings import DEMO


def _r(weight: float, *, every: int = 1, within: tuple[float, float] = (0.0, 1.0)) -> Term:
    return Term(COSTS["ours, pixel_normal"], {"pixel_normal": weight}, every, within)


_TERMS = {
    "vanilla": TERMS["vanilla"],
    "0.1, first half": _r(0.1, within=(0, 1 / 2)),
    "0.2, first half": _r(0.2, within=(0, 1 / 2)),
    "0.1, every 4th, first two thirds": _r(0.1, every=4, within=(0, 2 / 3)),
    "0.2, every 4th, last half": _r(0.2, every=4, within=(1 / 2, 1)),
    "0.1, every 4th": _r(0.1, every=4),
    "0.2, every 4th": _r(0.2, every=4),
    "0.4, every 8th": _r(0.4, every=8),
}
_SAME_TIME = "ours, demo"
_ALL = at_equal_time(
    DEMO["phases"], {**_TERMS, _SAME_TIME: TERMS[_SAME_TIME]._replace(cost=COSTS[_SAME_TIME])}, depth_mode="front"
)
CONFIG: dict = {"base": "demo", "variants": {name: _ALL[name] for name in _TERMS}}
