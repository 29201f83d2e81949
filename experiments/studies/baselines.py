"""What the regulariser brings beside those that it replaces or competes with; all else is shared.

Every variant is the demo's plain phase, then a surface phase whose loss has one regulariser more. Weights are those of
the authors, whose photometric loss is ours (0.8 L1 + 0.2 D-SSIM): 0.2 for SuGaR's pair of terms in either mode, 0.05
for 2DGS's depth-normal consistency; 0.2, the paper's, for all that align something with normals, DN-Splatter's axes
among them. SuGaR and 2DGS see no normals. `ours, demo` is the demo's mix (docs/deviations.md says why there is one).

SuGaR and the paper have an entropy phase and a cull before, which short runs do not bear; no variant has them.
"""

from gsjax.settings import DEMO

_VANILLA, _SURFACE = DEMO["phases"]
_NORMALS = {"normals": "{scene}/normals"}


def _with(**weights: float) -> dict:
    return {"phases": [_VANILLA, {**_SURFACE, "weights": weights}]}


CONFIG: dict = {
    "base": "demo",
    "variants": {
        "vanilla": {"vanilla": True},
        "SuGaR, sdf": _with(sugar_sdf=0.2),
        "SuGaR, density": _with(sugar_density=0.2),
        "2DGS, depth_normal": _with(depth_normal=0.05),
        "DN-Splatter, axis_normal": _with(axis_normal=0.2) | _NORMALS,
        "ours, sdf_normal": _with(sdf_normal=0.2) | _NORMALS,
        "ours, sdf_central": _with(sdf_central=0.2) | _NORMALS,
        "ours, sdf_bicubic": _with(sdf_bicubic=0.2) | _NORMALS,
        "ours, sdf_offset": _with(sdf_offset=0.2) | _NORMALS,
        "ours, density_center": _with(density_center=0.2) | _NORMALS,
        "ours, density_offset": _with(density_offset=0.2) | _NORMALS,
        "ours, density_sample": _with(density_sample=0.2) | _NORMALS,
        "ours, pixel_normal": _with(pixel_normal=0.2) | _NORMALS,
        "ours, demo": _with(**_SURFACE["weights"]) | _NORMALS,
    },
}
