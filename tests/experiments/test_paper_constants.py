"""The numbers of the paper and of what it builds on, each with its source and the place where this project has it.

"Paper" is its source text, "3DGS" the authors' code of 3D Gaussian Splatting, "SuGaR" the code that the paper starts
from.
"""

import importlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import pytest

from gsjax import config, pipeline
from gsjax.binding import refinement
from gsjax.binding.refinement import PRESETS as REFINEMENTS
from gsjax.binding.refinement import Refinement
from gsjax.meshing import density_field, level_set, poisson
from gsjax.presets import PRESETS, REFINED_BY, preset
from gsjax.settings import COLOR_RATE, MEANS_FINAL, OPACITY_RATE, Density, Rates, Settings
from gsjax.training.densification import gradient_driven
from gsjax.training.initialize import from_points
from rasterizer import GSPLAT, adam, similarity


class Constant(NamedTuple):
    """A number, or several that belong together."""

    name: str
    value: Any
    source: str
    read: Callable[[], Any]  # what the project has


class Budget(NamedTuple):
    """A phase of training: its steps, whether the number of Gaussians changes, weights, and the opacity culled at."""

    steps: int
    density_control: bool
    entropy: float
    sdf_normal: float
    cull_below: float


def budgets(settings: Settings) -> list[Budget]:
    """The phases of a run."""
    return [
        Budget(p.steps, p.density_control, p.weights.get("entropy", 0), p.weights.get("sdf_normal", 0), p.cull_below)
        for p in settings.schedule.phases
    ]


def refined(name: str) -> Refinement:
    """The refinement that goes with a preset of the training."""
    return config.parse(Refinement, REFINEMENTS[REFINED_BY[name]])


def vertex_rates(name: str) -> tuple[float, float]:
    """The vertices' rate at the first and the last step, without the size of the scene and of its mesh."""
    rate, last = refinement.vertex_rate(refined(name), 0.2, 4), refined(name).steps
    return tuple(float(f"{float(rate(step)):.3g}") for step in (0, last - 1))


def image_weights(settings: Settings) -> set[tuple[float, float]]:
    return {(phase.weights["l1"], phase.weights["dssim"]) for phase in settings.schedule.phases}


def default(function: Callable[..., Any], parameter: str) -> Any:
    return inspect.signature(function).parameters[parameter].default


def meshed(schedule: str) -> dict[str, Any]:
    """How the protocol asks for the coarse mesh."""
    run, out = importlib.import_module("paper_run"), Path("run")
    wishes = run.run_settings("room", schedule, 0, [], [])
    with mock.patch.object(pipeline, "mesh") as mesh:
        run._stages(out, out, wishes, (), "R")["mesh"]()
    return mesh.call_args.kwargs


def meshes_of_all() -> list[dict[str, Any]]:
    """The different ways in which the protocol asks for coarse meshes, over all methods of its tables."""
    meshes = [meshed(name) for name in importlib.import_module("paper.scenes").SCHEDULES]
    return [one for index, one in enumerate(meshes) if one not in meshes[:index]]


def protocol(schedule: str) -> dict[str, Any]:
    """The refinement that the protocol asks for."""
    return importlib.import_module("paper_run").run_settings("room", schedule, 0, [], [])["refinement"]


def asked_training(schedule: str) -> Settings:
    """The training that the protocol asks for."""
    return importlib.import_module("paper.scenes").settings_of("room", schedule, 0)


VANILLA, ENTROPY = Budget(7000, True, 0, 0, 0), Budget(2000, False, 0.1, 0, 0.5)
SUGAR_MESH = {"level": 0.3, "points": 10_000_000, "depth": 10, "trim_quantile": 0.1, "photo_refine": False,
              "keep_floaters": True}  # fmt: skip
PAPER, DGS = "Paper, Implementation Details", "3DGS, arguments/__init__.py"

CONSTANTS = (
    # The paper's budgets; entropy's weight and the cull after it are SuGaR's, which the paper follows.
    Constant("6,000 steps of R", [VANILLA, ENTROPY, Budget(6000, False, 0, 0.2, 0)], PAPER,
             lambda: budgets(preset("paper_6k_15k"))),
    Constant("13,000 steps of R", [VANILLA, ENTROPY, Budget(13000, False, 0, 0.2, 0)], PAPER,
             lambda: budgets(preset("paper_13k_7k"))),
    Constant("lambda_r where no scene has its own", 0.2, "Paper, after eq. 3: between 0.1 and 0.4",
             lambda: importlib.import_module("paper.scenes").PaperScene("", "").lambda_r),
    Constant("refined for", (15_000, 7_000), PAPER,
             lambda: (refined("paper_6k_15k").steps, refined("paper_13k_7k").steps)),
    Constant("weights of L1 and D-SSIM", {(0.8, 0.2)}, "Paper, after eq. 3; 3DGS for the 0.8 (docs/deviations.md)",
             lambda: image_weights(Settings()) | image_weights(preset("paper_13k_7k"))),
    Constant("the means' rate falls for", (30_000, 30_000), "Paper: 30,000 steps in all",
             lambda: (preset("paper_6k_15k").rates.decay_steps, preset("paper_13k_7k").rates.decay_steps)),
    Constant("Gaussians of the tables are on the mesh alone", False, "SuGaR, metrics of the refined model",
             lambda: protocol("paper_6k_15k")["keep_free"]),
    # 3DGS
    Constant("rates of the means", (1.6e-4, 1.6e-6), DGS, lambda: (Rates().means, MEANS_FINAL)),
    Constant("rates of colour", (2.5e-3, 2.5e-3 / 20), DGS, lambda: (COLOR_RATE, Rates().sh_rest)),
    Constant("rates of opacity, scale, rotation", (0.05, 0.005, 0.001), DGS,
             lambda: (OPACITY_RATE, Rates().scales, Rates().quats)),
    Constant("Adam's epsilon", 1e-15, "3DGS, scene/gaussian_model.py", lambda: default(adam, "eps")),
    Constant("first opacity", 0.1, "3DGS, scene/gaussian_model.py", lambda: default(from_points, "opacity")),
    Constant("harmonics", (3, 1000), DGS, lambda: (Settings().model.sh_degree, Settings().schedule.sh_every)),
    Constant("densified from, until, every", (500, 15_000, 100), DGS,
             lambda: (Density().start, Density().stop, Density().every)),
    Constant("gradient that grows", 2e-4, DGS, lambda: gradient_driven.GRADIENT),
    Constant("extent that splits and that is pruned", (0.01, 0.1), DGS,
             lambda: (gradient_driven.DENSE_SHARE, gradient_driven.MAX_SHARE)),
    Constant("halves are smaller by", 0.8 * 2, "3DGS, densify_and_split", lambda: gradient_driven.SPLIT),
    Constant("size prunes after", (False, True), "3DGS, train.py",
             lambda: tuple(gradient_driven.prunes_large(Density(), step) for step in (3000, 3001))),
    Constant("opacity that is pruned", 0.005, "3DGS, train.py", lambda: gradient_driven.MIN_OPACITY),
    Constant("opacities are reset to", 0.01, "3DGS, reset_opacity", lambda: gradient_driven.RESET_OPACITY),
    Constant("opacities are reset every", 3000, DGS, lambda: Density().reset_every),
    # Those of blending: `tests/rasterizer` holds what they do.
    Constant("alpha: at most, least, and the transmittance that ends a pixel", (0.99, 1 / 255, 1e-4),
             "3DGS, forward.cu", lambda: (GSPLAT.alpha_max, GSPLAT.alpha_min, GSPLAT.transmittance_min)),
    Constant("ends of a splat, sigmas", 3.33, "gsplat 1.6, where 3DGS has 3", lambda: GSPLAT.extent_sigmas),
    Constant("SSIM's window", (11, 1.5), "3DGS, loss_utils.py",
             lambda: (2 * similarity.WINDOW_RADIUS + 1, similarity.WINDOW_SIGMA)),
    Constant("3DGS at full length", [Budget(30_000, True, 0, 0, 0)], DGS,
             lambda: budgets(asked_training("3dgs_30k"))),
    # SuGaR
    Constant("SuGaR's phases", [VANILLA, ENTROPY, Budget(6000, False, 0, 0, 0)], "SuGaR, coarse_sdf.py",
             lambda: budgets(asked_training("sugar"))),
    Constant("weight of SuGaR's terms", 0.2, "SuGaR, coarse_sdf.py",
             lambda: asked_training("sugar").schedule.phases[-1].weights["sugar_sdf"]),
    Constant("the mesh of every method", [SUGAR_MESH], "Paper, Results: all by SuGaR's technique; coarse_mesh.py",
             meshes_of_all),
    Constant("refinement's triangles, Gaussians a triangle, harmonics", (1_000_000, 1, 3), "SuGaR, refine.py",
             lambda: (Refinement().faces, Refinement().per_triangle, Refinement().sh_degree)),
    Constant("weight of normal consistency", 0.1, "SuGaR, refine.py",
             lambda: Refinement().weights["normal_consistency"]),
    Constant("medium, long", (7_000, 15_000), "SuGaR, train.py",
             lambda: tuple(REFINEMENTS[name]["steps"] for name in ("medium", "long"))),
    Constant("vertices' rate at the first step and after 7,000, times 10 extent / sqrt(V)", (1.6e-4, 5.46e-5),
             "SuGaR, refine.py: to a hundredth in 30,000 steps at every length", lambda: vertex_rates("paper_13k_7k")),
    Constant("vertices' rate at the first step and after 15,000", (1.6e-4, 1.6e-5), "SuGaR, refine.py",
             lambda: vertex_rates("paper_6k_15k")),
    Constant("surface level, points, neighbours, samples", (0.3, 10_000_000, 16, 21), "SuGaR, coarse_mesh.py",
             lambda: (level_set.LEVEL, level_set.MOST_POINTS, level_set.NEIGHBORS, density_field.SAMPLES)),
    Constant("opacity that makes a surface", 0.5, "SuGaR, coarse_mesh.py", lambda: level_set.MIN_OPACITY),
    Constant("outliers and scale of Poisson", (20, 20.0, 1.1), "SuGaR, coarse_mesh.py; Open3D's default",
             lambda: (poisson.OUTLIER_NEIGHBORS, poisson.OUTLIER_RATIO, poisson.SCALE)),
)  # fmt: skip


@pytest.mark.parametrize("constant", CONSTANTS, ids=lambda constant: constant.name)
def test_a_number_is_that_of_its_source(scripts, constant):
    scripts("paper_run")  # `read` may import scripts of the experiments
    assert constant.read() == constant.value, constant.source


@pytest.mark.parametrize("name", PRESETS)
def test_a_term_that_a_preset_names_has_a_weight_that_counts(name):
    for phase in preset(name).schedule.phases:
        assert all(weight >= 0.01 for weight in phase.weights.values() if weight), phase
