"""How far more triangles, more Gaussians on each and more steps get, with all Gaussians on the mesh."""

from gsjax.binding.refining import PRESETS


def _bound(faces: int, per_triangle: int, steps: int) -> dict:
    more = {"faces": faces, "per_triangle": per_triangle, "steps": steps, "keep_free": False}
    return {"refine": {**PRESETS["fast"], **more}}


CONFIG: dict = {
    "variants": {
        "fast": _bound(30_000, 1, 1_000),
        "60,000 triangles": _bound(60_000, 1, 1_000),
        "3 on each": _bound(30_000, 3, 1_000),
        "60,000, twice the steps": _bound(60_000, 1, 2_000),
        "all, four times the steps": _bound(1_000_000, 1, 4_000),
        "free": {},
    },
}
