"""Who gets the budget on real photos: 3DGS's density control against error-driven densification, at the same number.

Small photos and few Gaussians, so that seeds are cheap: both rules fill the budget well before they end.
"""

_PLAIN = {
    "vanilla": True,
    "downscale": 2,
    "max_gaussians": 12_000,
    "phases": [
        {"name": "coarse", "steps": 300, "image_scale": 2, "density_control": True},
        {"name": "vanilla", "steps": 900, "density_control": True},
    ],
    "sh_every": 120,
}
CONFIG: dict = {
    "base": "fox",
    "variants": {
        "adc": {**_PLAIN, "density": {"rule": "adc", "stop": 700}},
        "error": {**_PLAIN, "density": {"rule": "error", "stop": 700}},
    },
}
