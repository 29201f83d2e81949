"""Something far behind the cloud that training starts with: without it few photos end in fog, with either rule.

A quarter of the photos' size, so that it is minutes.
"""


def _plain(rule: str, far_points: int) -> dict:
    return {
        "vanilla": True,
        "downscale": 4,
        "max_gaussians": 24_000,
        "far_points": far_points,
        "phases": [{"name": "vanilla", "steps": 2000, "density_control": True}],
        "density": {"rule": rule},
    }


CONFIG: dict = {
    "base": "fox",
    "variants": {
        f"{rule}, {'far points' if count else 'none'}": _plain(rule, count)
        for rule in ("adc", "error")
        for count in (0, 1_800)
    },
}
