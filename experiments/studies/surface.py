"""The surface phase against plain 3DGS at equal steps: with true normals, and with the run's own smoothed ones."""

CONFIG: dict = {
    "base": "bunny_plane",
    "variants": {
        "vanilla": {"vanilla": True},
        "true normals": {"normals": "{scene}/normals"},
        "own smoothed normals": {"normals": None},
    },
}
