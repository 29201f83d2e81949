"""Training runs by name: what differs from the defaults of `gsjax.settings`.

Each preset shortens the phases of the paper and moves their boundaries in proportion.
"""

from collections.abc import Callable, Mapping
from typing import Any

from gsjax import config
from gsjax.errors import InputError
from gsjax.settings import AUTO, PAPER_PHASES, Settings


def _phase(name: str, steps: int, **more: Any) -> dict:
    return {"name": name, "steps": steps, **more}


RATES: dict[str, float] = {"means": 3.2e-4, "sh_rest": 5e-4, "scales": 0.01, "quats": 0.003, "final_share": 0.2}
"""Of the presets for photos: larger than 3DGS's, whose runs are longer (experiments/results/rates.md)."""

_OWN: dict[str, Any] = {
    "supervision": {"normal_gate": True, "stereo_weight": 0.05},
    "effects": {"names": AUTO},
    "model": {
        "depth_mode": "front",  # thin things are not as deep as their far sides' light has them (docs/deviations.md)
        "pixel_filter": "mip",  # right at other sizes and distances than the photos' too (docs/deviations.md)
        "far_points": 1_800,
    },
    "schedule": {"sparse_views": True},
    "rates": RATES,
    "density": {"rule": "error", "start": 50, "full_by": 0.6, "reset_every": 0},
}


_MAPS_WEIGHT = 0.4  # of `pixel_normal`: maps add what photos do not show (experiments/results/room_stages.md)


def _phases(coarse: int, vanilla: int, surface: int, image: int, **terms: float) -> list[dict[str, Any]]:
    """So many steps of each phase; the surface phase may have more terms.

    Surface terms see photos of half the size. The image alone ends the run: pictures are sharper, and the surface stays
    where it is (experiments/results/room_stages.md).
    """
    terms = {"pixel_normal": 0.1, "multi_view": 0.06, "photometric": 0.3, **terms}
    return [
        _phase("coarse", coarse, image_scale=2, density_control=True),
        _phase("vanilla", vanilla, density_control=True),
        _phase("surface", surface, weights=terms, surface_every=4, surface_scale=2),
        _phase("image", image, weights={"measured_depth": 0}),
    ]


FAST = config.merge(
    _OWN,
    {
        "photos": {"cpu_pixels": 300_000},
        "model": {"max_gaussians": 60_000, "stereo_points": 15_000},
        # The gradient at the means brings nothing more in so few steps (experiments/results/price_on_photos.md).
        "schedule": {"sh_every": 300, "phases": _phases(900, 200, 700, 350)},
        "rates": {"means": 1.28e-3},
        "density": {"stop": 1000},
        "logging": {"evaluate_every": 250, "checkpoint_every": 250},
    },
)
QUICK = config.merge(  # small photos and their image alone: a step takes less than half as long, one program to compile
    FAST,
    {
        "supervision": {"stereo_weight": 0},  # it takes as long as half of the steps
        "model": {"max_gaussians": 36_000, "stereo_points": 0},
        "schedule": {"sh_every": 150, "phases": [_phase("coarse", 900, image_scale=2, density_control=True)]},
        "rates": {"means": RATES["means"], "sh_rest": 1e-3},
        "density": {"start": 30, "stop": 630, "every": 50},
    },
)
BALANCED = config.merge(
    _OWN,
    {
        "model": {"max_gaussians": 120_000, "stereo_points": 30_000},
        "schedule": {"sh_every": 700, "phases": _phases(1500, 500, 1000, 500, sdf_normal=0.05)},
        "density": {"stop": 1500},
    },
)
ACCURATE = config.merge(
    _OWN,
    {
        "model": {"max_gaussians": 300_000, "stereo_points": 75_000},
        "schedule": {"sh_every": 1300, "phases": _phases(2500, 3500, 5000, 4000, sdf_normal=0.05)},
        "density": {"start": 100, "stop": 5400},
    },
)


def _of_the_paper(**surface: Any) -> dict[str, Any]:
    phases = [config.to_dict(phase) for phase in PAPER_PHASES]
    return {"schedule": {"phases": [*phases[:-1], phases[-1] | surface]}, "rates": {"decay_steps": 30000}}


DEMO: dict[str, Any] = {
    "model": {
        "background": "white",
        "depth_mode": "front",
        "pixel_filter": "mip",  # its pixels are means over their area, unsharpened
        "max_gaussians": 12_000,
        "sh_degree": 2,
    },
    "schedule": {
        "sh_every": 150,
        "phases": [
            _phase("vanilla", 100, density_control=True),
            _phase(
                "surface",
                900,
                weights={"sdf_normal": 0.1, "pixel_normal": 0.6, "thickness": 0.02, "coverage": 0.05},
                surface_every=4,
                density_control=True,
            ),
        ],
    },
    "rates": RATES,
    "density": {
        "rule": "error",
        "start": 50,
        "stop": 600,
        "every": 50,
        "full_by": 0.6,
        "replace": 0.05,
        "reset_every": 0,
    },
    "logging": {"metrics_every": 50, "evaluate_every": 0, "checkpoint_every": 2000},
}
"""The built-in scene at 192x192 pixels with its true normals (`gsjax.pipeline.demo`).

R acts in both forms: `sdf_normal`, the paper's, is composited, `pixel_normal` is taken at each pixel's surface point.
R and `thickness` act while Gaussians densify: splats that are thin by then cost pictures nothing
(experiments/results/price_of_r.md). `coverage` closes holes where the ground has the colour of the background
(experiments/results/ablation.md).
"""

PRESETS: dict[str, dict[str, Any]] = {
    "quick": QUICK,
    "fast": FAST,
    "balanced": BALANCED,
    "accurate": ACCURATE,
    "paper_6k_15k": _of_the_paper(),
    "paper_13k_7k": _of_the_paper(steps=13_000),
}
REFINED_BY = {
    "quick": "fast",
    "fast": "fast",
    "balanced": "balanced",
    "accurate": "long",
    "paper_6k_15k": "long",
    "paper_13k_7k": "medium",
}
"""Of every preset, that of `gsjax.binding.refinement.PRESETS` by which its mesh is refined."""
LENGTHS = ("quick", "fast", "balanced", "accurate")
"""Of the presets, what a budget of time chooses from, the shortest first."""


def table(name: str, *, with_maps: bool) -> dict[str, Any]:
    """The table of a preset. With normal maps, `pixel_normal` weighs more in the presets for photos."""
    if not with_maps or name not in LENGTHS or name == "quick":
        return PRESETS[name]
    return config.merge(
        PRESETS[name], {"schedule": {"phases": {"surface": {"weights": {"pixel_normal": _MAPS_WEIGHT}}}}}
    )


def settings_of(name: str, parse: Callable[[Mapping[str, Any]], Settings]) -> Settings:
    """The settings that a function makes of a preset's table. Normal maps among them change weights, see `table`."""
    settings = parse(PRESETS[name])
    return settings if settings.supervision.normals is None else parse(table(name, with_maps=True))


def preset(name: str, differences: Mapping[str, Any] | None = None) -> Settings:
    """The settings of a preset, with differences from it. Normal maps among them change weights, see `table`.

    Args:
        name: Of `PRESETS`.
        differences: What differs, a table for each group of `Settings`, as in `{"model": {"max_gaussians": 9_000}}`.

    Raises:
        InputError: The preset or a field is unknown, or a value is out of range.
    """
    if name not in PRESETS:
        raise InputError(f"preset {name!r} is none of {', '.join(PRESETS)}")

    def parse(base: Mapping[str, Any]) -> Settings:
        return config.parse(Settings, config.merge(base, differences or {}), where=f"preset {name}")

    return settings_of(name, parse)
