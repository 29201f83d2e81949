"""Settings of the experiments' data sets by name: `base`, and what the others change of it.

Nested as `gsjax/settings.py` has it. Lists (the phases) are replaced as a whole. An unknown key is an error that names
the nearest known one.
"""

from typing import Any

from gsjax.config import merge, parse, to_dict
from gsjax.presets import DEMO, PRESETS
from gsjax.settings import NONE, Rates, Settings

# No effects: runs are compared by the score of the render as it is. No sparse-view regularization.
_BASE: dict[str, Any] = merge(PRESETS["fast"], {"effects": {"names": NONE}, "schedule": {"sparse_views": False}})
_DEMO = to_dict(parse(Settings, DEMO))

CONFIGS: dict[str, dict[str, Any]] = {
    "base": _BASE,
    # The built-in scene as `gsjax demo` trains it, whatever `base` is.
    "demo": _DEMO,
    # The same in twice the steps, at the rates of 3DGS, with a surface phase of its own after the plain steps, which
    # variants of a study have in common.
    "built_in": merge(
        _DEMO,
        {
            "schedule": {
                "sh_every": 400,
                "phases": [
                    {"name": "vanilla", "steps": 1000, "density_control": True},
                    {
                        "name": "surface",
                        "steps": 850,
                        "weights": {"pixel_normal": 0.25, "thickness": 0.02},
                        "surface_every": 4,
                    },
                ],
            },
            "rates": to_dict(Rates()),
            "density": {
                "rule": "error",
                "start": 200,
                "stop": 900,
                "every": 100,
                "full_by": 0.9,
                "replace": 0.05,
                "reset_every": 0,
            },
        },
    ),
    # Sixty rendered views of a scanned mesh on a plane, with true normals. Rates and ramp are 3DGS's: those of `fast`
    # gain 0.7 dB here and cost a third of the mesh's accuracy.
    "bunny_plane": {
        "model": {"background": "white", "max_gaussians": 20_000, "sh_degree": 2},
        "schedule": {
            "sh_every": 500,
            "phases": [
                {"name": "coarse", "steps": 400, "image_scale": 2, "density_control": True},
                {"name": "vanilla", "steps": 1000, "density_control": True},
                {
                    "name": "surface",
                    "steps": 800,
                    "weights": {"sdf_normal": 0.1, "pixel_normal": 0.4, "thickness": 0.02},
                },
            ],
        },
        "rates": to_dict(Rates()),
        "density": {"start": 200, "stop": 1200, "every": 100, "full_by": 0.9, "replace": 0.05},
    },
    # Fifty real photos of an indoor scene, 267x475 pixels (the undistorted COLMAP model).
    "fox": {},
}
