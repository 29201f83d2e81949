"""Both signs of the regulariser: ours minimises mean(1 - |cos|), the printed one adds |cos| (a weight below zero)."""


def _surface(weight: float) -> dict:
    return {
        "normals": "{scene}/normals",
        "phases": [
            {"name": "vanilla", "steps": 800, "density_control": True},
            {"name": "surface", "steps": 500, "weights": {"sdf_normal": weight}},
        ],
    }


CONFIG: dict = {
    "base": "demo",
    "variants": {
        "none": {**_surface(0.2), "vanilla": True},
        "1 - |cos|": _surface(0.2),
        "printed + |cos|": _surface(-0.2),
    },
}
