"""Sixty rendered views of a scanned mesh on a plane; `--set normals=SCENE/normals` gives the true normals.

Rates and ramp are 3DGS's: those of `fast` gain 0.7 dB here and cost a third of the mesh's accuracy.
"""

from gsjax.config import to_dict
from gsjax.settings import Rates

CONFIG: dict = {
    "background": "white",
    "max_gaussians": 20_000,
    "sh_degree": 2,
    "sh_every": 500,
    "phases": [
        {"name": "coarse", "steps": 400, "image_scale": 2, "density_control": True},
        {"name": "vanilla", "steps": 1000, "density_control": True},
        {"name": "surface", "steps": 800, "weights": {"sdf_normal": 0.1, "pixel_normal": 0.4, "thickness": 0.02}},
    ],
    "rates": to_dict(Rates()),
    "density": {"start": 200, "stop": 1200, "every": 100, "full_by": 0.9, "replace": 0.05},
}
