"""What depth is in the surface phase and in the scores: of splats' centres, of their planes, of those planes in front."""

CONFIG: dict = {
    "base": "demo",
    "variants": {
        "centre": {"normals": "{scene}/normals", "depth_mode": "center"},
        "plane": {"normals": "{scene}/normals", "depth_mode": "plane"},
        "front": {"normals": "{scene}/normals", "depth_mode": "front"},
    },
}
