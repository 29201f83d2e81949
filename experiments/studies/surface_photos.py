"""What the surface phase of real photos is trained on: own smoothed normals, or that photos agree with each other.

Small photos and few Gaussians. Without truth there are held-out photos and pictures of the normals to judge by.
"""

_VANILLA = [
    {"name": "coarse", "steps": 300, "image_scale": 2, "density_control": True},
    {"name": "vanilla", "steps": 900, "density_control": True},
]
_OWN = {"sdf_normal": 0.05, "pixel_normal": 0.05}
_VIEWS = {"multi_view": 0.03, "photometric": 0.15}


def _with(**weights: float) -> dict:
    phases = [*_VANILLA, {"name": "surface", "steps": 600, "weights": weights}]
    return {"downscale": 2, "max_gaussians": 16_000, "density": {"stop": 700}, "phases": phases}


CONFIG: dict = {
    "base": "fox",
    "variants": {
        "vanilla": _with(),
        "own normals": _with(**_OWN),
        "multi_view, photometric": _with(**_VIEWS),
        "all of them": _with(**_OWN, **_VIEWS),
    },
}
