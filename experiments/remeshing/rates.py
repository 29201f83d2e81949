"""Rates of the refinement's Gaussians, from 3DGS's upwards. Unsettled, and triangles by decimation alone."""

from gsjax.binding.refining import PRESETS

_FAST = {**PRESETS["fast"], "settle_at": 1.0, "halved_share": 0.0}


def _rated(scales: float, rotations: float, sh_dc: float, sh_rest: float, final_share: float) -> dict:
    rates = {
        "scales": scales,
        "rotations": rotations,
        "sh_dc": sh_dc,
        "sh_rest": sh_rest,
        "final_share": final_share,
    }
    return {"refine": {**_FAST, "rates": {**_FAST["rates"], **rates}}}


CONFIG: dict = {
    "variants": {
        "3DGS's": _rated(0.005, 0.001, 0.0025, 1.25e-4, 1.0),
        "between, sizes and turns": _rated(0.01, 0.003, 0.0025, 5e-4, 0.2),
        "between": _rated(0.01, 0.01, 0.0025, 1e-3, 0.1),
        "fast": {"refine": _FAST},
        "twice as large": _rated(0.04, 0.04, 0.01, 4e-3, 0.05),
        "free": {},
    },
}
