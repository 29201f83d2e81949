"""At which points R looks, and what the paper's entropy phase does to a short run, from the same plain steps."""


def _then(*phases: dict) -> dict:
    plain = {"name": "vanilla", "steps": 1000, "density_control": True}
    return {"phases": [plain, *phases], "normals": "{scene}/normals"}


def _surface(steps: int = 600, **weights: float) -> dict:
    return {"name": "surface", "steps": steps, "weights": weights}


CONFIG: dict = {
    "base": "bunny_plane",
    "variants": {
        "plain": _then(_surface()),
        "at the means 0.2": _then(_surface(sdf_normal=0.2)),
        "the same after entropy and a cull": _then(
            {"name": "entropy", "steps": 100, "weights": {"entropy": 0.1}, "cull_below": 0.1},
            _surface(500, sdf_normal=0.2),
        ),
        "at the means 0.2, at the pixels 0.1": _then(_surface(sdf_normal=0.2, pixel_normal=0.1)),
        "at the pixels 0.2": _then(_surface(pixel_normal=0.2)),
    },
}
