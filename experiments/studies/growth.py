"""Who gets the budget: 3DGS's density control against error-driven densification, at the same number of Gaussians."""

_PLAIN = {"vanilla": True}
CONFIG: dict = {
    "base": "bunny_plane",
    "variants": {
        "adc": {**_PLAIN, "density": {"rule": "adc"}},
        "error": {**_PLAIN, "density": {"rule": "error"}},
    },
}
