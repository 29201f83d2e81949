"""Numbers of mesh and refinement, from the base run."""

import time
from typing import Any

from gsjax import config, pipeline
from gsjax.binding.refining import PRESETS, Refinement
from knobs.knob import Knob, Measured, Place


def _meshed(place: Place, options: dict[str, Any], round_: int) -> Measured:
    file = place.fresh(f"mesh_{round_}") / "mesh.ply"
    file.parent.mkdir(parents=True)
    run, started = place.run, time.perf_counter()
    pipeline.mesh(run, file, **options)
    seconds = time.perf_counter() - started
    return Measured(seconds, pipeline.evaluate(run, mesh=file))


def _refined(place: Place, options: dict[str, Any], round_: int) -> Measured:
    folder, mesh = place.fresh(f"refined_{round_}"), place.mesh
    settings = config.parse(Refinement, config.merge({**PRESETS["fast"], "seed": round_}, options))
    started = time.perf_counter()
    pipeline.refine(place.run, folder, settings, mesh=mesh)
    seconds = time.perf_counter() - started
    return Measured(seconds, pipeline.evaluate(folder, mesh=folder / "mesh.ply"))


def _surface_errors(outcome: dict[str, Any], best: dict[str, Any]) -> dict[str, float]:
    return {
        "Chamfer, % more": 100 * (outcome["chamfer"] / best["chamfer"] - 1),
        "F-score lost": best["fscore"] - outcome["fscore"],
    }


def _refined_errors(outcome: dict[str, Any], best: dict[str, Any]) -> dict[str, float]:
    return {"PSNR lost, dB": best["psnr"] - outcome["psnr"], **_surface_errors(outcome, best)}


KNOBS: dict[str, Knob] = {
    "surface points": Knob(
        {f"{count:,}": {"points": count} for count in (400_000, 200_000, 100_000, 50_000)}, _meshed, _surface_errors
    ),
    "Poisson depth": Knob({str(depth): {"depth": depth} for depth in (9, 8, 7, 6)}, _meshed, _surface_errors),
    "settling": Knob({"settled": {}, "unsettled": {"settled": False}}, _meshed, _surface_errors),
    "refinement steps": Knob(
        {f"{steps:,}": {"steps": steps} for steps in (1000, 500, 250, 100)}, _refined, _refined_errors
    ),
    "refinement triangles": Knob(
        {f"{faces:,}": {"faces": faces} for faces in (30_000, 15_000, 8_000, 4_000)}, _refined, _refined_errors
    ),
}
