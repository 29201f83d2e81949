"""What depth is in the surface phase and in the scores: that of centres, of planes, or of the planes in front."""

CONFIG: dict = {
    "base": "demo",
    "variants": {
        "centre": {"normals": "{scene}/normals", "depth_mode": "center"},
        "plane": {"normals": "{scene}/normals", "depth_mode": "plane"},
        "front": {"normals": "{scene}/normals", "depth_mode": "front"},
    },
}
