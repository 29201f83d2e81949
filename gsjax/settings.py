"""Every number of a training run, as frozen records; presets are differences from the defaults.

Defaults are those of 3DGS and of the paper at full scale; each preset shortens the phases and moves their boundaries
in proportion.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

from gsjax import config
from gsjax.config import declare_types, parse_numbers
from gsjax.errors import InputError

MOST_COUNT = 2**31 - 1  # of the integers of compiled programs
MOST_SEED = 2**32 - 1  # of jax's random keys and numpy's generators alike


def check_lowest(record: Any, **lowest: float) -> None:
    """Raise ValueError for the first field that is under its lowest value, not finite, or a count that is too high."""
    for name, low in lowest.items():
        value = getattr(record, name)
        if value < low:
            raise ValueError(f"{name}={value} is below {low}")
        if not value < math.inf:
            raise ValueError(f"{name}={value} is not a finite number")
        if isinstance(value, int) and value > MOST_COUNT:
            raise ValueError(f"{name}={value} is above {MOST_COUNT}")


def check_seed(seed: int) -> None:
    """Raise ValueError for a seed that random numbers cannot begin with."""
    if not 0 <= seed <= MOST_SEED:
        raise ValueError(f"seed={seed} is not between 0 and {MOST_SEED}")


PLAIN = MappingProxyType({"l1": 0.8, "dssim": 0.2, "alpha": 0.1})
"""Weights of the terms of the image, which every phase has unless it says otherwise (3DGS; the matte's is ours)."""


class Weights(Mapping[str, float]):
    """Weights of the loss terms by name: those of `PLAIN`, and what is named beside them; hashable.

    The names are those of `gsjax.training.terms.TERMS` and of the terms that a run is handed; `gsjax.training.plan`
    checks them. A term of weight 0 is not in the compiled program.
    """

    def __init__(self, **weights: float):
        """The weights that differ from `PLAIN`."""
        self._by_name = {**PLAIN, **parse_numbers(weights, where="Weights")}

    def __getitem__(self, name: str) -> float:
        """The weight of a term that was named."""
        return self._by_name[name]

    def __iter__(self) -> Iterator[str]:
        """The names."""
        return iter(self._by_name)

    def __len__(self) -> int:
        """How many are named."""
        return len(self._by_name)

    def __hash__(self) -> int:
        """Equal weights have equal hashes."""
        return hash(frozenset(self._by_name.items()))

    def __repr__(self) -> str:
        """As it is written."""
        return f"Weights({', '.join(f'{name}={weight}' for name, weight in self.items())})"


@dataclass(frozen=True)
class Phase:
    """A stretch of training with fixed terms: one compiled step."""

    name: str
    steps: int
    weights: Mapping[str, float] = Weights()  # of the terms by name, as `Weights` completes them
    image_scale: int = 1  # photos this many times smaller in each direction
    density_control: bool = False  # clone, split, prune, reset
    cull_below: float = 0.0  # at the end, Gaussians of lower opacity are removed
    surface_every: int = 1  # one of so many steps has the terms of the surface, the others are cheaper without
    surface_scale: int = 1  # photos of the steps with those terms are this many times smaller still

    def __post_init__(self):
        """Check types and ranges."""
        declare_types(self)
        check_lowest(self, steps=0, image_scale=1, surface_every=1, surface_scale=1)
        if not 0 <= self.cull_below <= 1:
            raise ValueError(f"cull_below={self.cull_below} is not between 0 and 1")
        object.__setattr__(self, "weights", Weights(**self.weights))


@dataclass(frozen=True)
class Rates:
    """Adam learning rates of 3DGS (its arguments/__init__.py)."""

    means: float = 1.6e-4  # times the scene extent
    means_final: float = 1.6e-6  # times the scene extent, reached log-linearly at `decay_steps`
    decay_steps: int | None = None  # None: the steps of all phases
    sh_dc: float = 0.0025
    sh_rest: float = 0.000125
    opacities: float = 0.05
    scales: float = 0.005
    quats: float = 0.001
    final_share: float = 1.0  # of all rates but the means', reached log-linearly in the last third of `decay_steps`

    def __post_init__(self):
        """Check types and ranges."""
        declare_types(self)
        rates = ("means", "sh_dc", "sh_rest", "opacities", "scales", "quats")
        check_lowest(self, **dict.fromkeys(rates, 0))
        if self.decay_steps is not None:
            check_lowest(self, decay_steps=1)
        if not 0 < self.final_share <= 1:
            raise ValueError(f"final_share={self.final_share} is not above 0 and at most 1")
        if not 0 < self.means_final <= self.means:
            raise ValueError(f"means_final={self.means_final} is not between 0 and means={self.means}")


@dataclass(frozen=True)
class Density:
    """Clone, split, prune and reset, at a fixed budget of Gaussians."""

    rule: str = "adc"  # who grows, a name of `gsjax.training.growth.rules.RULES`
    start: int = 500
    stop: int = 15000
    every: int = 100
    gradient: float = 2e-4  # adc: mean norm of the loss' gradient to the 2D mean, in NDC units
    dense_share: float = 0.01  # adc, of the extent: larger Gaussians split, smaller ones are cloned
    full_by: float = 0.9  # error: where between `start` and `stop` the budget is full, reached geometrically
    replace: float = 0.1  # error: share that moves in each densification, from the least seen to the worst
    min_opacity: float = 0.005
    max_share: float = 0.1  # of the extent: larger ones are pruned, see `adaptive.prunes_large`; error: the near ones
    reset_every: int = 3000  # and, over a white background, at `start`; 0: never

    def __post_init__(self):
        """Check types and ranges."""
        declare_types(self)
        check_lowest(self, start=0, stop=0, every=1, gradient=0, dense_share=0, max_share=0, reset_every=0)
        for name in ("full_by", "replace", "min_opacity"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name}={getattr(self, name)} is not between 0 and 1")


@dataclass(frozen=True)
class Logging:
    """What is written when, in steps."""

    metrics_every: int = 50
    evaluate_every: int = 500  # PSNR of the held-out views; 0: only at the end
    checkpoint_every: int = 500  # and at the end of every phase

    def __post_init__(self):
        """Check types and ranges."""
        declare_types(self)
        check_lowest(self, metrics_every=1, evaluate_every=0, checkpoint_every=1)


SIMULATED = ("exposure", "vignetting", "poses", "background", "transients")  # effects that training can take in
EFFECTS = (*SIMULATED, "sky", "blur")  # that --effects names: also where no surface is, and photos to leave out
AUTO, NONE = "auto", "none"


def named_effects(effects: str) -> tuple[str, ...]:
    """The effects that a setting names, in their order; of "auto" and "none" none.

    Raises:
        ValueError: One of them is unknown.
    """
    names = () if effects in (AUTO, NONE) else tuple(name.strip() for name in effects.split(","))
    for name in names:
        if name not in EFFECTS:
            raise ValueError(f"effects={effects}: {name!r} is none of auto, none, {', '.join(EFFECTS)}")
    return tuple(name for name in EFFECTS if name in names)


VANILLA = Phase("vanilla", 7000, density_control=True)
ENTROPY = Phase("entropy", 2000, Weights(entropy=0.1), cull_below=0.5)
SURFACE = Phase("surface", 6000, Weights(sdf_normal=0.2))


@dataclass(frozen=True)
class Settings:
    """A training run."""

    seed: int = 0
    downscale: float | None = None  # photos are so many times smaller; None: see `longest_side` and `cpu_pixels`
    images: str | None = None  # folder of the photos, within the data set or absolute; None: looked for
    photos: str | None = None  # file of the names of those that the run looks at, one a line; None: all
    hold_out: str = "auto"  # every N-th photo, "none", a file of names, or "auto" (`gsjax.io.splits`)
    normals: str | None = None  # folder of maps (`gsjax.io.normal_folders.find`); None: smoothed normals of own depth
    normal_axes: str | None = None  # of the maps, such as "+x-y-z"; None: found by comparing with the rendered depth
    normal_gate: bool = False  # a normal counts as far as photos of the same place agree (`gsjax.normals.consistency`)
    depth: str | None = None  # folder of measured depth, within the data set or anywhere, or "auto": as it lists them
    depth_unit: Literal["mm", "cm", "m", "scene"] | None = None  # of those maps; None: as depth.json beside them says
    depth_weight: float = 0.2  # of the term `measured_depth`, where there are such maps and a phase sets no other
    sky: str | None = None  # folder of masks, 0 where photos show sky, found as `depth` is, or "auto": it must be seen
    sky_weight: float = 0.1  # of the term `sky`, where photos show any
    points: str | None = None  # PLY of points to start from, in the data set's coordinates; None: the data set's own
    background: Literal["white", "black", "random"] = "black"
    masks: Literal["valid", "matte"] = "valid"
    depth_mode: Literal["plane", "front", "center"] = "plane"  # how depth is read, see `gsjax.rendering`
    pixel_filter: Literal["classic", "mip"] = "classic"  # see `gsjax.rendering.PIXEL_FILTERS`
    effects: str = NONE  # "none"; "auto", those that the photos show; or names, as in "exposure,vignetting"
    vanilla: bool = False  # plain 3DGS for the same number of steps: no entropy, no cull, no normals
    phases: tuple[Phase, ...] = (VANILLA, ENTROPY, SURFACE)
    views_per_step: int = 1  # photos whose mean loss a step descends; what counts in steps here counts in photos then
    max_gaussians: int = 1_000_000
    far_points: int = 0  # around the cloud that training starts with too; none over white or where photos have mattes
    stereo_points: int = 0  # where photos agree about depth, beside that cloud; half of the budget at most
    sparse_views: bool = False  # photos far apart are not learned by heart (`gsjax.planning.sparse_views`)
    dropout: float = 0.0  # share of the Gaussians that each step leaves out, for few photos far apart
    sh_degree: int = 3
    sh_every: int = 1000  # steps between the bands of the ramp
    rates: Rates = Rates()
    density: Density = Density()
    logging: Logging = Logging()
    longest_side: int = 1600  # of a photo, pixels, where no downscale is given (3DGS)
    cpu_pixels: int | None = None  # of a photo on a CPU, most, where no downscale is given; None: any number

    def __post_init__(self):
        """Check types and ranges."""
        declare_types(self)
        check_seed(self.seed)
        check_lowest(self, views_per_step=1, max_gaussians=1, far_points=0, stereo_points=0, sh_every=1, longest_side=1)
        named_effects(self.effects)
        if self.downscale is not None and not 1 <= self.downscale < math.inf:
            raise ValueError(f"downscale={self.downscale} is not a number of at least 1")
        check_lowest(self, depth_weight=0, sky_weight=0)
        if self.depth is None and self.depth_unit is not None:
            raise ValueError(f"depth_unit={self.depth_unit} is the unit of no maps: depth names their folder")
        if self.depth is not None and self.vanilla:
            raise ValueError("vanilla is plain 3DGS, which has no term for depth: leave one of the two out")
        if self.cpu_pixels is not None and self.cpu_pixels < 1:
            raise ValueError(f"cpu_pixels={self.cpu_pixels} is below 1")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout={self.dropout} is not at least 0 and below 1")
        if not 0 <= self.sh_degree <= 4:
            raise ValueError(f"sh_degree={self.sh_degree} is not 0 to 4")
        if not self.phases:
            raise ValueError("there are no phases")


def total_steps(settings: Settings) -> int:
    """Steps of all phases."""
    return sum(phase.steps for phase in settings.phases)


def _phase(name: str, steps: int, **more: Any) -> dict:
    return {"name": name, "steps": steps, **more}


RATES: dict[str, float] = {"means": 3.2e-4, "sh_rest": 5e-4, "scales": 0.01, "quats": 0.003, "final_share": 0.2}
"""Of the presets for photos: larger than 3DGS's, whose runs are longer (experiments/results/rates.md)."""

# On short schedules the SDF gradient at every pixel's own surface point helps the one at the means, and an entropy
# phase costs more than it brings. What photos say of each other makes flat what normals of one's own leave rough
# (docs/deviations.md, experiments/results/mesh_terms.md).
_SURFACE_TERMS = {"sdf_normal": 0.05, "pixel_normal": 0.05, "multi_view": 0.03, "photometric": 0.15}
# For photos of half the size. The gradient at the means brings nothing more there, and costs most; `multi_view` counts
# pixels, of which the same way has half as many (experiments/results/price_on_photos.md).
_HALF_SIZE_TERMS = {"pixel_normal": 0.1, "multi_view": 0.06, "photometric": 0.3}
FAST: dict[str, Any] = {
    "depth_mode": "front",  # thin things are not as deep as their far sides' light has them (docs/deviations.md)
    "effects": AUTO,
    "normal_gate": True,
    "sparse_views": True,
    "pixel_filter": "mip",  # right at other sizes and distances than the photos' too (docs/deviations.md)
    "max_gaussians": 60_000,
    "far_points": 1_800,
    "cpu_pixels": 300_000,
    "sh_every": 300,
    "phases": [
        _phase("coarse", 900, image_scale=2, density_control=True),
        _phase("vanilla", 200, density_control=True),
        _phase("surface", 1000, weights=_HALF_SIZE_TERMS, surface_every=4, surface_scale=2),
    ],
    "rates": {**RATES, "means": 1.28e-3},
    "density": {"rule": "error", "start": 50, "stop": 1000, "full_by": 0.6, "reset_every": 0},
    "logging": {"evaluate_every": 250, "checkpoint_every": 250},
}
QUICK = {  # small photos and their image alone: a step takes less than half as long, and one program is all to compile
    **FAST,
    "max_gaussians": 36_000,
    "sh_every": 150,
    "phases": [_phase("coarse", 900, image_scale=2, density_control=True)],
    "rates": {**RATES, "sh_rest": 1e-3},
    "density": {**FAST["density"], "start": 30, "stop": 630, "every": 50},
}
BALANCED = {
    "depth_mode": "front",
    "effects": AUTO,
    "normal_gate": True,
    "sparse_views": True,
    "pixel_filter": "mip",
    "max_gaussians": 120_000,
    "far_points": 1_800,
    "sh_every": 700,
    "rates": RATES,
    "phases": [
        _phase("coarse", 1000, image_scale=2, density_control=True),
        _phase("vanilla", 5000, density_control=True),
        _phase("surface", 2000, weights=_SURFACE_TERMS),
    ],
    "density": {"rule": "error", "start": 50, "stop": 3600, "full_by": 0.6, "reset_every": 0},
}
ACCURATE = {  # `balanced` in as many steps as the paper's
    **BALANCED,
    "max_gaussians": 300_000,
    "sh_every": 1300,
    "phases": [
        _phase("coarse", 1900, image_scale=2, density_control=True),
        _phase("vanilla", 9350, density_control=True),
        _phase("surface", 3750, weights=_SURFACE_TERMS),
    ],
    "density": {"rule": "error", "start": 100, "stop": 6700, "full_by": 0.6, "reset_every": 0},
}
PAPER_6K_15K = {
    "phases": [
        _phase("vanilla", 7000, density_control=True),
        _phase("entropy", 2000, weights={"entropy": 0.1}, cull_below=0.5),
        _phase("surface", 6000, weights={"sdf_normal": 0.2}),
    ],
    "rates": {"decay_steps": 30000},
}
PAPER_13K_7K = {
    "phases": [
        _phase("vanilla", 7000, density_control=True),
        _phase("entropy", 2000, weights={"entropy": 0.1}, cull_below=0.5),
        _phase("surface", 13000, weights={"sdf_normal": 0.2}),
    ],
    "rates": {"decay_steps": 30000},
}

DEMO: dict[str, Any] = {
    "background": "white",
    "depth_mode": "front",
    "pixel_filter": "mip",  # its pixels are means over their area, unsharpened
    "max_gaussians": 12_000,
    "sh_degree": 2,
    "sh_every": 150,
    "phases": [
        _phase("vanilla", 100, density_control=True),
        _phase("surface", 900, weights={"pixel_normal": 0.6, "thickness": 0.02}, surface_every=4, density_control=True),
    ],
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

R and `thickness` act while Gaussians multiply: splats that are thin by then cost pictures nothing
(experiments/results/price_of_r.md).
"""

PRESETS: dict[str, dict[str, Any]] = {
    "quick": QUICK,
    "fast": FAST,
    "balanced": BALANCED,
    "accurate": ACCURATE,
    "paper_6k_15k": PAPER_6K_15K,
    "paper_13k_7k": PAPER_13K_7K,
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


def preset(name: str, differences: Mapping[str, Any] | None = None) -> Settings:
    """The settings of a preset, with differences from it.

    Args:
        name: Of `PRESETS`.
        differences: Fields of `Settings` by name; records within are tables of what differs.

    Raises:
        InputError: The preset or a field is unknown, or a value is out of range.
    """
    if name not in PRESETS:
        raise InputError(f"preset {name!r} is none of {', '.join(PRESETS)}")
    return config.parse(Settings, config.merge(PRESETS[name], differences or {}), where=f"preset {name}")
