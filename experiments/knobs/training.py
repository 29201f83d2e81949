"""Settings of training: a run each, scored on held-out views."""

from typing import Any

from gsjax import pipeline
from gsjax.io import runs
from gsjax.pipeline.evaluate import score_surface
from gsjax.pipeline.result import open_result, scene_of_run
from gsjax.settings import DEMO, SIMULATED
from gsjax.training.losses import SURFACE_TERMS
from knobs.knob import Knob, Measured, Place

_VANILLA, _SURFACE = DEMO["phases"]


def _measure(place: Place, difference: dict[str, Any], round_: int) -> Measured:
    """Seconds of a run without its compilations, and its scores."""
    folder = place.fresh(f"training_{round_}")
    figures = pipeline.train(place.scene, folder, place.settings(difference, round_))
    compiled = sum(each["seconds"] for record in runs.read_metrics(folder) for each in record.get("compiled", ()))
    result, scene = open_result(folder), scene_of_run(folder)
    assert scene.truth is not None, "the normals are compared with true ones"
    surface = score_surface(result.gaussians, scene.held_out_frames, scene.truth)
    scores = {"psnr": figures["psnr"], "normals": surface["normal_error_all_deg"]}
    return Measured(figures["train_seconds"] - compiled, scores)


def _errors(outcome: dict[str, float], best: dict[str, float]) -> dict[str, float]:
    return {
        "PSNR lost, dB": best["psnr"] - outcome["psnr"],
        "normals, degrees more": outcome["normals"] - best["normals"],
    }


def _phases(vanilla: dict[str, Any], surface: dict[str, Any]) -> dict[str, Any]:
    return {"phases": [{**_VANILLA, **vanilla}, {**_SURFACE, **surface}]}


def _steps(phase: str, *factors: float) -> dict[str, dict[str, Any]]:
    """The steps of one phase, times some factors."""
    first, second = _VANILLA["steps"], _SURFACE["steps"]
    if phase == "vanilla":
        return {f"x {factor:g}": _phases({"steps": round(factor * first)}, {}) for factor in factors}
    return {f"x {factor:g}": _phases({}, {"steps": round(factor * second)}) for factor in factors}


def _coarse(share: float) -> dict[str, Any]:
    """A share of the first phase at half the size of the photos."""
    steps = round(share * _VANILLA["steps"])
    coarse = {**_VANILLA, "name": "coarse", "steps": steps, "image_scale": 2}
    return {"phases": [coarse, {**_VANILLA, "steps": _VANILLA["steps"] - steps}, _SURFACE]}


def _rarer(count: int) -> dict[str, Any]:
    """R in one of so many steps, and as many times as strong."""
    weights = {name: count * w if name in SURFACE_TERMS else w for name, w in _SURFACE["weights"].items()}
    return _phases({}, {"surface_every": count, "weights": weights})


def _slope(name: str) -> dict[str, Any]:
    return _phases({}, {"weights": {name: 0.2}})


def _knob(values: dict[str, dict[str, Any]]) -> Knob:
    return Knob(values, _measure, _errors)


KNOBS: dict[str, Knob] = {
    "Gaussians": _knob({f"{count:,}": {"max_gaussians": count} for count in (24_000, 12_000, 6_000, 3_000, 1_500)}),
    "harmonics": _knob({f"degree {degree}": {"sh_degree": degree} for degree in (3, 2, 1, 0)}),
    "rule of growth": _knob({rule: {"density": {"rule": rule}} for rule in ("error", "adc")}),
    "steps at half size": _knob({f"{share:.0%}": _coarse(share) for share in (0.0, 0.25, 0.5, 0.75)}),
    "vanilla steps": _knob(_steps("vanilla", 2, 1, 0.5, 0.25)),
    "surface steps": _knob(_steps("surface", 2, 1, 0.5, 0.25)),
    "R": _knob({label: _rarer(count) for label, count in (("every step", 1), ("every 2nd", 2), ("every 4th", 4))}),
    "slope of R": _knob({name: _slope(name) for name in ("sdf_bicubic", "sdf_central", "sdf_normal")}),
    **{f"effect: {name}": _knob({"simulated": {"effects": name}, "absent": {}}) for name in (*SIMULATED, "sh_degree")},
    "depth of a splat": _knob({mode: {"depth_mode": mode} for mode in ("plane", "front", "center")}),
}
