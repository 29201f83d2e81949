"""Numbers of mesh, refinement and texture, from the base run.

A mesh is measured from the true surface; of real photos, which have none, by its own colours in the held-out ones.
"""

import time
from pathlib import Path
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
    return Measured(seconds, pipeline.evaluate(run, mesh=file) if place.has_truth else _shown(place, file))


def _refined(place: Place, options: dict[str, Any], round_: int) -> Measured:
    folder, mesh = place.fresh(f"refined_{round_}"), place.mesh
    settings = config.parse(Refinement, config.merge({**PRESETS["fast"], "seed": round_}, options))
    started = time.perf_counter()
    pipeline.refine(place.run, folder, settings, mesh=mesh)
    seconds = time.perf_counter() - started
    return Measured(seconds, pipeline.evaluate(folder, mesh=folder / "mesh.ply"))


def _textured(place: Place, size: int | None, round_: int) -> Measured:
    file, mesh = place.fresh(f"texture_{round_}") / "textured.glb", place.mesh
    file.parent.mkdir(parents=True)
    started = time.perf_counter()
    pipeline.texture(place.run, mesh, file, size=size)
    seconds = time.perf_counter() - started
    return Measured(seconds, _shown(place, file))


def _shown(place: Place, file: Path) -> dict[str, float]:
    """How a mesh looks in the held-out photos: `psnr` over the pixels that it covers, and the share of them."""
    figures = pipeline.evaluate(place.run, mesh=file)
    return {"psnr": figures["mesh_psnr"], "covered": figures["mesh_covers"]}


def _errors(outcome: dict[str, Any], best: dict[str, Any]) -> dict[str, float]:
    """Distances where there is a truth; of what was shown its PSNR and what it no longer covers."""
    found = {}
    if "covered" in outcome:
        found["PSNR lost, dB"] = best["psnr"] - outcome["psnr"]
        found["covered less, %"] = 100 * (best["covered"] - outcome["covered"])
    if "chamfer" in outcome:
        found["Chamfer, % more"] = 100 * (outcome["chamfer"] / best["chamfer"] - 1)
        found["F-score lost"] = best["fscore"] - outcome["fscore"]
    return found


def _refined_errors(outcome: dict[str, Any], best: dict[str, Any]) -> dict[str, float]:
    return {"PSNR lost, dB": best["psnr"] - outcome["psnr"], **_errors(outcome, best)}


_OF_MESHES = _meshed, _errors
_OF_REFINED = _refined, _refined_errors
KNOBS: dict[str, Knob] = {
    "surface points": Knob(
        {f"{count:,}": {"points": count} for count in (400_000, 200_000, 100_000, 50_000)}, *_OF_MESHES
    ),
    "Poisson depth": Knob({str(depth): {"depth": depth} for depth in (9, 8, 7, 6)}, *_OF_MESHES),
    "settling": Knob({"settled": {}, "unsettled": {"settled": False}}, *_OF_MESHES),
    "refinement steps": Knob({f"{steps:,}": {"steps": steps} for steps in (1000, 500, 250, 100)}, *_OF_REFINED),
    "refinement triangles": Knob(
        {f"{faces:,}": {"faces": faces} for faces in (30_000, 15_000, 8_000, 4_000)}, *_OF_REFINED
    ),
    "refined mesh settles": Knob(
        {f"after {share:g} of the steps": {"settle_at": share} for share in (0.6, 0.8)} | {"never": {"settle_at": 1.0}},
        *_OF_REFINED,
    ),
    "texture": Knob(
        {f"{size:,} px": size for size in (4096, 2048, 1024, 512)} | {"as the photos": None},
        _textured,
        _errors,
    ),
}
