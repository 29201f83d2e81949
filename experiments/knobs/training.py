"""Settings of training: a run each, scored on held-out views."""

import time
from collections.abc import Mapping
from typing import Any

import jax
from terms import TERMS

from gsjax import pipeline, runs
from gsjax.runs.result import open_result, scene_of_run
from gsjax.scoring.surfaces import score_surface
from gsjax.settings import SIMULATED
from gsjax.training.terms import weigh_terms
from knobs.knob import Knob, Measured, Place

_STEPS = (2, 1, 0.5, 0.25)  # times a config's


def knobs_of(config: Mapping[str, Any]) -> dict[str, Knob]:
    """The knobs of training: differences from a whole config whose last phase is the surface's."""
    *plain, surface = config["phases"]
    vanilla, steps, most = plain[-1], sum(phase["steps"] for phase in plain), config["max_gaussians"]

    def with_plain(factor: float) -> dict[str, Any]:
        return {"phases": [*({**phase, "steps": round(factor * phase["steps"])} for phase in plain), surface]}

    def with_surface(**difference: Any) -> dict[str, Any]:
        return {"phases": [*plain, {**surface, **difference}]}

    def coarse(share: float) -> dict[str, Any]:
        """A share of the plain steps at half the size of the photos."""
        small = round(share * steps)
        first = {**vanilla, "name": "coarse", "steps": small, "image_scale": 2}
        return {"phases": [first, {**vanilla, "steps": steps - small}, surface]}

    def rarer(count: int) -> dict[str, Any]:
        """R in one of so many steps, and as many times as strong; what costs no time stays in every step."""
        times = count / surface.get("surface_every", 1)
        dear = {each.name: times * each.weight for each in weigh_terms(surface["weights"]) if each.is_dear}
        return with_surface(surface_every=count, weights={**surface["weights"], **dear})

    values: dict[str, dict[str, dict[str, Any]]] = {
        "Gaussians": {f"{round(f * most):,}": {"max_gaussians": round(f * most)} for f in (2, 1, 0.5, 0.25, 0.125)},
        "harmonics": {f"degree {degree}": {"sh_degree": degree} for degree in (3, 2, 1, 0)},
        "rule of growth": {rule: {"density": {"rule": rule}} for rule in ("error", "adc")},
        "steps at half size": {f"{share:.0%}": coarse(share) for share in (0.0, 0.25, 0.5, 0.75)},
        "plain steps": {f"x {factor:g}": with_plain(factor) for factor in _STEPS},
        "surface steps": {f"x {factor:g}": with_surface(steps=round(factor * surface["steps"])) for factor in _STEPS},
        "R": {label: rarer(count) for label, count in (("every step", 1), ("every 2nd", 2), ("every 4th", 4))},
        "slope of R": {
            name: with_surface(weights={name: 0.2})
            for name in ("sdf_bicubic", "sdf_central", "sdf_normal", "pixel_normal")
        },
        "depth of a splat": {mode: {"depth_mode": mode} for mode in ("front", "plane", "center")},
        **{f"effect: {name}": {"simulated": {"effects": name}, "absent": {}} for name in (*SIMULATED, "sh_degree")},
    }
    return {name: Knob(each, _measure, _errors) for name, each in values.items()}


def _measure(place: Place, difference: dict[str, Any], round_: int) -> Measured:
    """Seconds of a run without its compilations, and its scores.

    On a CPU the seconds are the processor's: over a minute other programs come and go.
    """
    folder, clocks = place.fresh(f"training_{round_}"), (time.process_time, time.perf_counter)
    started = [clock() for clock in clocks]
    figures = pipeline.train(place.scene, folder, place.settings(difference, round_), terms=TERMS)
    busy, wall = (clock() - start for clock, start in zip(clocks, started, strict=True))
    share = busy / wall if jax.default_backend() == "cpu" else 1.0
    compiled = sum(each["seconds"] for record in runs.read_metrics(folder) for each in record.get("compiled", ()))
    result, scene = open_result(folder), scene_of_run(folder)
    scores = {"psnr": figures["psnr"]}
    if scene.truth is not None:
        surface = score_surface(result.gaussians, scene.held_out_frames, scene.truth, result.depth_mode)
        scores["normals"] = surface["normal_error_all_deg"]
    return Measured(share * (figures["train_seconds"] - compiled), scores)


def _errors(outcome: dict[str, float], best: dict[str, float]) -> dict[str, float]:
    found = {"PSNR lost, dB": best["psnr"] - outcome["psnr"]}
    if "normals" in outcome:
        found["normals, degrees more"] = outcome["normals"] - best["normals"]
    return found
