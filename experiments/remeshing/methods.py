"""How a mesh is made of the same Gaussians, and whether it then settles on the photos."""

CONFIG: dict = {
    "variants": {
        "poisson": {},
        "poisson, unsettled": {"mesh": {"settled": False}},
        "depth": {"mesh": {"method": "depth"}},
        "tsdf": {"mesh": {"method": "tsdf"}},
    },
}
