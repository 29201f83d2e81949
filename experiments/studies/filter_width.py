"""Either pixel filter in a short plain training on halved photos, at their size, at half and at double.

Another width is another `eps2d` of `mip` in `gsjax.render.PIXEL_FILTERS`.
"""

_SHORT = {
    "vanilla": True,
    "downscale": 2,
    "max_gaussians": 12_000,
    "phases": [
        {"name": "coarse", "steps": 350, "image_scale": 2, "density_control": True},
        {"name": "vanilla", "steps": 650, "density_control": True},
    ],
    "density": {"start": 30, "stop": 600},
    "sh_every": 150,
}
CONFIG: dict = {
    "base": "fox",
    "zooms": (0.5, 2),
    "variants": {name: {**_SHORT, "pixel_filter": name} for name in ("classic", "mip")},
}
