"""The regularisers of other mesh makers, beside the normal term and without it.

Weights are those of their authors, whose loss of the image is ours (0.8 L1 + 0.2 D-SSIM). `depth_normal` 0.05 (2DGS),
`multi_view` 0.03 and `photometric` 0.15 (PGSR) are means as theirs are. 2DGS's distortion has 1000 (single objects) in
device coordinates of near 0.2; ours counts in depths of the surface, so the same pull is 1000 (0.2 / z)^2 = 40 / z^2, z
the distance of the object in 2DGS's unit: somewhat under 3 there (its meshes are fused to a depth of 3), hence 5.
"""

from gsjax.settings import DEMO

_VANILLA, _SURFACE = DEMO["phases"]
_FLAT = {"thickness": _SURFACE["weights"]["thickness"]}
_DISTORTION, _DEPTH_NORMAL = {"distortion": 5.0}, {"depth_normal": 0.05}
_MULTI_VIEW, _PHOTOMETRIC = {"multi_view": 0.03}, {"photometric": 0.15}


def _without(*terms: dict[str, float]) -> dict:
    """A surface phase of these terms, without normals."""
    weights = {name: weight for term in (_FLAT, *terms) for name, weight in term.items()}
    return {"phases": [_VANILLA, {**_SURFACE, "weights": weights}]}


def _beside(*terms: dict[str, float]) -> dict:
    """The demo's surface phase with true normals, and these terms."""
    return {**_without(_SURFACE["weights"], *terms), "normals": "{scene}/normals"}


CONFIG: dict = {
    "base": "demo",
    "variants": {
        "no term": _without(),
        "distortion": _without(_DISTORTION),
        "depth_normal": _without(_DEPTH_NORMAL),
        "multi_view": _without(_MULTI_VIEW),
        "photometric": _without(_PHOTOMETRIC),
        "multi_view, photometric": _without(_MULTI_VIEW, _PHOTOMETRIC),
        "all four": _without(_DISTORTION, _DEPTH_NORMAL, _MULTI_VIEW, _PHOTOMETRIC),
        "normals": _beside(),
        "normals and distortion": _beside(_DISTORTION),
        "normals and depth_normal": _beside(_DEPTH_NORMAL),
        "normals and multi_view": _beside(_MULTI_VIEW),
        "normals and photometric": _beside(_PHOTOMETRIC),
    },
}
