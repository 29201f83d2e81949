"""The settings that trade accuracy for time: the values of each, and how one value is measured."""

import shutil
import time
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import jax

from gsjax import pipeline, runs
from gsjax.binding.refinement import PRESETS, Refinement
from gsjax.config import merge, parse
from gsjax.io.scenes import load_scene
from gsjax.metrics.truth_maps import score_surface
from gsjax.runs.result import open_result, scene_of_run
from gsjax.settings import SIMULATED, Settings
from gsjax.training.terms import weigh_terms

Scores = dict[str, float]
ERRORS: dict[str, tuple[str, Callable[[float, float], float]]] = {
    "psnr": ("PSNR lost, dB", lambda own, best: best - own),
    "covered": ("covered less, %", lambda own, best: 100 * (best - own)),
    "normals": ("normals, degrees more", lambda own, best: own - best),
    "chamfer": ("Chamfer, % more", lambda own, best: 100 * (own / best - 1)),
    "fscore": ("F-score lost", lambda own, best: best - own),
}
"""Score -> its error's unit, and the error of a value from its score and that of the most accurate value."""
STEPS = (2, 1, 0.5, 0.25)  # times those of a config


class Place:
    """A data set, a folder for runs, and the run whose mesh, refinement and texture are varied."""

    def __init__(self, scene: str | Path, out: str | Path, config: Mapping[str, Any], share: float):
        """Trains nothing yet.

        Args:
            scene: Data set; its `normals` are used where it has them.
            out: Folder for the runs.
            config: A whole one, from which values are differences.
            share: Of its steps, in every run.
        """
        self.scene, self.out, self.config, self._share = Path(scene), Path(out), config, share

    def settings(self, difference: Mapping[str, Any], seed: int) -> Settings:
        """The config's settings with a difference, in this place's share of the steps."""
        normals = self.scene / "normals"
        inputs = {"seed": seed} | ({"supervision": {"normals": str(normals)}} if normals.is_dir() else {})
        return pipeline.scaled(parse(Settings, merge(self.config, inputs, difference)), self._share)

    def fresh(self, name: str) -> Path:
        """A new empty folder of this place."""
        folder = self.out / "runs" / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    @cached_property
    def has_truth(self) -> bool:
        """Whether the data set has a true surface."""
        return load_scene(self.scene).truth is not None

    @cached_property
    def run(self) -> Path:
        """The run with the config as it is, trained once."""
        folder = self.out / "base"
        pipeline.train(self.scene, folder, self.settings({}, 0), resume=folder.exists())
        return folder

    @cached_property
    def mesh(self) -> Path:
        """Its mesh."""
        file = self.run / "mesh.ply"
        if not file.exists():
            pipeline.mesh(self.run, file)
        return file


class Varied(NamedTuple):
    """One setting."""

    values: Mapping[str, Any]  # by their labels, the most accurate first
    measure: Callable[[Place, Any, int], tuple[float, Scores]]  # (where, a value, the round) -> seconds and scores


def errors(own: Scores, best: Scores) -> Scores:
    """The errors of a value by their units."""
    return {unit: error(own[name], best[name]) for name, (unit, error) in ERRORS.items() if name in own}


def table(config: Mapping[str, Any]) -> dict[str, Varied]:
    """Every setting by its name; `config` is a whole one, with a phase `surface`."""
    return {name: Varied(values, trained) for name, values in of_training(config).items()} | {
        "surface points": Varied({f"{n:,}": {"points": n} for n in (400_000, 200_000, 100_000, 50_000)}, meshed),
        "Poisson depth": Varied({str(depth): {"depth": depth} for depth in (9, 8, 7, 6)}, meshed),
        "photometric vertex refinement": Varied({"on": {}, "off": {"photo_refine": False}}, meshed),
        "refinement steps": Varied({f"{n:,}": {"steps": n} for n in (1000, 500, 250, 100)}, refined),
        "refinement triangles": Varied({f"{n:,}": {"faces": n} for n in (30_000, 15_000, 8_000, 4_000)}, refined),
        "refined mesh is refined on photos": Varied(
            {f"after {share:g} of the steps": {"photo_refine_at": share} for share in (0.6, 0.8, 1.0)}, refined
        ),
        "texture": Varied({f"{n:,} px": n for n in (4096, 2048, 1024, 512)} | {"as the photos": None}, textured),
    }


def of_training(config: Mapping[str, Any]) -> dict[str, dict[str, dict[str, Any]]]:
    """Settings of the training: by name the differences from a config, by label."""
    phases = config["schedule"]["phases"]
    at = [phase["name"] for phase in phases].index("surface")
    plain, surface, after = phases[:at], phases[at], phases[at + 1 :]
    vanilla, steps, most = plain[-1], sum(phase["steps"] for phase in plain), config["model"]["max_gaussians"]

    def with_plain(factor: float) -> dict[str, Any]:
        longer = [{**phase, "steps": round(factor * phase["steps"])} for phase in plain]
        return {"schedule": {"phases": [*longer, surface, *after]}}

    def with_surface(**difference: Any) -> dict[str, Any]:
        return {"schedule": {"phases": [*plain, {**surface, **difference}, *after]}}

    def coarse(share: float) -> dict[str, Any]:
        """A share of the plain steps with photos of half the size."""
        small = round(share * steps)
        first = {**vanilla, "name": "coarse", "steps": small, "image_scale": 2}
        return {"schedule": {"phases": [first, {**vanilla, "steps": steps - small}, surface, *after]}}

    def rarer(count: int) -> dict[str, Any]:
        """R in one of so many steps, and as many times as strong; terms that cost no time stay in every step."""
        times = count / surface.get("surface_every", 1)
        dear = {each.name: times * each.weight for each in weigh_terms(surface["weights"]) if each.is_dear}
        return with_surface(surface_every=count, weights={**surface["weights"], **dear})

    return {
        "Gaussians": {
            f"{round(f * most):,}": {"model": {"max_gaussians": round(f * most)}} for f in (2, 1, 0.5, 0.25, 0.125)
        },
        "harmonics": {f"degree {degree}": {"model": {"sh_degree": degree}} for degree in (3, 2, 1, 0)},
        "densification rule": {rule: {"density": {"rule": rule}} for rule in ("error", "adc")},
        "steps at half size": {f"{share:.0%}": coarse(share) for share in (0.0, 0.25, 0.5, 0.75)},
        "plain steps": {f"x {factor:g}": with_plain(factor) for factor in STEPS},
        "surface steps": {f"x {factor:g}": with_surface(steps=round(factor * surface["steps"])) for factor in STEPS},
        "R": {label: rarer(count) for label, count in (("every step", 1), ("every 2nd", 2), ("every 4th", 4))},
        "points of R": {name: with_surface(weights={name: 0.2}) for name in ("sdf_normal", "pixel_normal")},
        "depth of a splat": {mode: {"model": {"depth_mode": mode}} for mode in ("front", "plane", "center")},
        **{f"effect: {name}": {"simulated": {"effects": {"names": name}}, "absent": {}} for name in SIMULATED},
    }


def trained(place: Place, difference: Mapping[str, Any], seed: int) -> tuple[float, Scores]:
    """Seconds of a training without its compilations; on a CPU the processor's, as other programs come and go."""
    folder, clocks = place.fresh(f"training_{seed}"), (time.process_time, time.perf_counter)
    started = [clock() for clock in clocks]
    figures = pipeline.train(place.scene, folder, place.settings(difference, seed))
    busy, wall = (clock() - start for clock, start in zip(clocks, started, strict=True))
    share = busy / wall if jax.default_backend() == "cpu" else 1.0
    compiled = sum(each["seconds"] for record in runs.read_metrics(folder) for each in record.get("compiled", ()))
    result, scene, scores = open_result(folder), scene_of_run(folder), {"psnr": figures["psnr"]}
    if scene.truth is not None:
        surface = score_surface(result.gaussians, scene.held_out_frames, scene.truth, result.depth_mode)
        scores["normals"] = surface["normal_error_all_deg"]
    return share * (figures["train_seconds"] - compiled), scores


def meshed(place: Place, options: Mapping[str, Any], seed: int) -> tuple[float, Scores]:
    """Seconds of a mesh; of one without a true surface, the scores of its own colours in the held-out photos."""
    run, file = place.run, place.fresh(f"mesh_{seed}") / "mesh.ply"
    seconds = _seconds(lambda: pipeline.mesh(run, file, **options))
    return seconds, distances(pipeline.evaluate(run, mesh=file)) if place.has_truth else in_photos(run, file)


def refined(place: Place, options: Mapping[str, Any], seed: int) -> tuple[float, Scores]:
    """Seconds of a refinement."""
    mesh, folder = place.mesh, place.fresh(f"refined_{seed}")
    settings = parse(Refinement, merge(PRESETS["fast"], {"seed": seed}, options))
    seconds = _seconds(lambda: pipeline.refine(place.run, folder, settings, mesh=mesh))
    figures = pipeline.evaluate(folder, mesh=folder / "mesh.ply")
    return seconds, {"psnr": figures["psnr"], **distances(figures)}


def textured(place: Place, size: int | None, seed: int) -> tuple[float, Scores]:
    """Seconds of a texture."""
    mesh, file = place.mesh, place.fresh(f"texture_{seed}") / "textured.glb"
    seconds = _seconds(lambda: pipeline.texture(place.run, mesh, file, size=size))
    return seconds, in_photos(place.run, file)


def distances(figures: Mapping[str, Any]) -> Scores:
    """Scores against the true surface, where there is one."""
    return {name: figures[name] for name in ("chamfer", "fscore") if name in figures}


def in_photos(run: Path, file: Path) -> Scores:
    """How a mesh looks in the held-out photos: `psnr` over the pixels that it covers, and the share of them."""
    figures = pipeline.evaluate(run, mesh=file)
    return {"psnr": figures["mesh_psnr"], "covered": figures["mesh_covers"]}


def _seconds(work: Callable[[], Any]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started
