"""When R at the pixels acts: in which part of the surface phase's time, in how many of its steps, with what weight.

All else, depth in front and the time among it, is as in `baselines_front.py`; the rest of a phase is plain.
"""

from studies.baselines import Term, at_equal_time
from studies.baselines_front import COSTS

from gsjax.settings import DEMO


def when(phases: list[dict], costs: dict[str, float]) -> dict[str, dict]:
    """Variants by name, with what a step costs by `costs`."""

    def r(weight: float, begin: float, end: float, every: int = 1) -> Term:
        return Term(costs["ours, pixel_normal"], {"pixel_normal": weight}, every, (begin, end))

    terms = {
        "ours, demo": Term(costs["ours, demo"], phases[-1]["weights"]),
        "vanilla": Term(1.0, {}),
        "0.1, first half": r(0.1, 0, 1 / 2),
        "0.2, first half": r(0.2, 0, 1 / 2),
        "0.1, every 4th, first two thirds": r(0.1, 0, 2 / 3, every=4),
        "0.2, every 4th, last half": r(0.2, 1 / 2, 1, every=4),
        "0.1, every 4th": r(0.1, 0, 1, every=4),
        "0.2, every 4th": r(0.2, 0, 1, every=4),
        "0.4, every 8th": r(0.4, 0, 1, every=8),
    }
    variants = at_equal_time(phases, terms, depth_mode="front")
    return {name: change for name, change in variants.items() if name != "ours, demo"}


CONFIG: dict = {"base": "demo", "variants": when(DEMO["phases"], COSTS)}
