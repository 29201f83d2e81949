"""What a splat's depth is in the surface phase and in the scores: its centre's, or that of its plane."""

CONFIG: dict = {
    "base": "demo",
    "variants": {
        "centre": {"normals": "{scene}/normals", "depth_mode": "center"},
        "plane": {"normals": "{scene}/normals", "depth_mode": "plane"},
    },
}
