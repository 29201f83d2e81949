"""How splats meet pixels: 3DGS's filter against Mip-Splatting's, at the size of training, at half and at double.

Photos of the double size must be there: a data set is trained on at half of its size or less.
"""

_PLAIN = {"vanilla": True, "downscale": 2}
CONFIG: dict = {
    "base": "fox",
    "zooms": (0.5, 2),
    "variants": {
        "classic": {**_PLAIN, "pixel_filter": "classic"},
        "mip": {**_PLAIN, "pixel_filter": "mip"},
    },
}
