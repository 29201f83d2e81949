"""Every number of a training run, as frozen records, grouped as the packages that read them.

Defaults are those of 3DGS and of the paper at full scale. `gsjax.presets` has what differs in shorter runs.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, Literal, Self

from gsjax.config import declare_types, parse_numbers, refuse_moved

MOST_COUNT = 2**31 - 1  # of the integers of compiled programs
MOST_SEED = 2**32 - 1  # of jax's random keys and numpy's generators alike


def check_lowest(record: Any, **lowest: float) -> None:
    """Raise ValueError for a field below its lowest value, not finite, or a count that is too high; None passes."""
    for name, low in lowest.items():
        value = getattr(record, name)
        if value is None:
            continue
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
    """Weights of the loss terms by name: those of `PLAIN`, and what is named in addition; hashable.

    The names are those of `gsjax.training.terms.TERMS` and of a run's own terms; `gsjax.training.plan`
    checks them. A term of weight 0 is not in the compiled program.
    """

    def __init__(self, **weights: float):
        """The weights that differ from `PLAIN`."""
        self._by_name = {**PLAIN, **parse_numbers(weights, where="Weights")}

    def __getitem__(self, name: str) -> float:
        return self._by_name[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)

    def __hash__(self) -> int:
        return hash(frozenset(self._by_name.items()))

    def __repr__(self) -> str:
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
        declare_types(self)
        check_lowest(self, steps=0, image_scale=1, surface_every=1, surface_scale=1)
        if not 0 <= self.cull_below <= 1:
            raise ValueError(f"cull_below={self.cull_below} is not between 0 and 1")
        object.__setattr__(self, "weights", Weights(**self.weights))


MEANS_FINAL = 1.6e-6  # times the scene extent: the last learning rate of the means (3DGS, arguments/__init__.py)
COLOR_RATE, OPACITY_RATE = 0.0025, 0.05  # learning rates of `sh_dc` and of opacities (the same)


@dataclass(frozen=True)
class Rates:
    """Adam learning rates of 3DGS (its arguments/__init__.py), with `COLOR_RATE` and `OPACITY_RATE`."""

    means: float = 1.6e-4  # times the scene extent; falls log-linearly to `MEANS_FINAL` at `decay_steps`
    decay_steps: int | None = None  # None: the steps of all phases
    sh_rest: float = 0.000125
    scales: float = 0.005
    quats: float = 0.001
    final_share: float = 1.0  # of all rates but the means', reached log-linearly in the last third of `decay_steps`

    def __post_init__(self):
        declare_types(self)
        check_lowest(self, means=MEANS_FINAL, sh_rest=0, scales=0, quats=0, decay_steps=1)
        if not 0 < self.final_share <= 1:
            raise ValueError(f"final_share={self.final_share} is not above 0 and at most 1")


@dataclass(frozen=True)
class Density:
    """Clone, split, prune and reset, at a fixed budget of Gaussians."""

    rule: str = "adc"  # a name of `gsjax.training.densification.rules.DENSIFICATION_RULES`
    start: int = 500
    stop: int = 15000
    every: int = 100

    full_by: float = 0.9  # error: where between `start` and `stop` the budget is full, reached geometrically
    replace: float = 0.1  # error: share that moves in each densification, from the least seen to the worst
    reset_every: int = 3000  # and, over a white background, at `start`; 0: never

    def __post_init__(self):
        declare_types(self)
        check_lowest(self, start=0, stop=0, every=1, reset_every=0)
        for name in ("full_by", "replace"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name}={getattr(self, name)} is not between 0 and 1")


@dataclass(frozen=True)
class Logging:
    """What is written when, in steps."""

    metrics_every: int = 50
    evaluate_every: int = 500  # PSNR of the held-out views; 0: only at the end
    checkpoint_every: int = 500  # and at the end of every phase

    def __post_init__(self):
        declare_types(self)
        check_lowest(self, metrics_every=1, evaluate_every=0, checkpoint_every=1)


EFFECTS: Mapping[str, str] = {
    "exposure": "gsjax.effects.exposure",
    "vignetting": "gsjax.effects.vignetting",
    "poses": "gsjax.effects.poses",
    "sky": "gsjax.effects.sky",
    "background": "gsjax.effects.background",
    "transients": "gsjax.effects.transients",
    "blur": "gsjax.effects.blur",
}
"""The effects in the order in which they are validated -> module with the `EFFECT`, a `gsjax.effects.kinds` record."""
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


PAPER_PHASES = (
    Phase("vanilla", 7000, density_control=True),
    Phase("entropy", 2000, Weights(entropy=0.1), cull_below=0.5),
    Phase("surface", 6000, Weights(sdf_normal=0.2)),
)


@dataclass(frozen=True)
class Photos:
    """Which photos a run reads, and at which size."""

    images: str | None = None  # folder of the photos, within the data set or absolute; None: the data set's own
    subset: str | None = None  # file that names the photos to use, one a line; None: all
    hold_out: str = "auto"  # every N-th photo, "none", a file of names, or "auto" (`gsjax.io.splits`)
    masks: Literal["valid", "matte"] = "valid"  # what the masks/ folder means: usable pixels, or coverage
    downscale: float | None = None  # photos are so many times smaller; None: see `longest_side` and `cpu_pixels`
    longest_side: int = 1600  # of a photo, pixels, where no downscale is given (3DGS)
    cpu_pixels: int | None = None  # of a photo on a CPU, most, where no downscale is given; None: any number

    def __post_init__(self):
        declare_types(self)
        check_lowest(self, longest_side=1, cpu_pixels=1)
        if self.downscale is not None and not 1 <= self.downscale < math.inf:
            raise ValueError(f"downscale={self.downscale} is not a number of at least 1")


@dataclass(frozen=True)
class Supervision:
    """What a run compares with in addition to the photos: maps of normals and of measured depth."""

    normals: str | None = None  # folder of maps (`gsjax.io.normal_folders.find`); None: smoothed normals of own depth
    normal_axes: str | None = None  # of the maps, such as "+x-y-z"; None: determined from the rendered depth
    normal_gate: bool = False  # normals that photos of the same place contradict weigh less (`normals.consistency`)
    depth: str | None = None  # folder of measured depth, within the data set or anywhere, or "auto": as it lists them
    depth_unit: Literal["mm", "cm", "m", "scene"] | None = None  # of those maps; None: as depth.json next to them says
    depth_weight: float = 0.2  # of the term `measured_depth`, where there are such maps and a phase sets no other
    stereo_weight: float = 0.0  # the same of multi-view stereo (`gsjax.stereo`), whose normals serve too where no maps
    # are given; 0: there is no stereo

    def __post_init__(self):
        declare_types(self)
        check_lowest(self, depth_weight=0, stereo_weight=0)
        if self.depth is None and self.depth_unit is not None:
            raise ValueError(f"depth_unit={self.depth_unit} is the unit of no maps: depth names their folder")


@dataclass(frozen=True)
class Model:
    """The Gaussians: how many, from which points they start, and how they are drawn."""

    max_gaussians: int = 1_000_000
    points: str | None = None  # PLY of points to start from, in the data set's coordinates; None: the data set's own
    far_points: int = 0  # around the cloud that training starts with too; none over white or where photos have mattes
    stereo_points: int = 0  # by multi-view stereo, in addition to that cloud; half of the budget at most
    sh_degree: int = 3
    pixel_filter: Literal["classic", "mip"] = "classic"  # see `gsjax.rendering.PIXEL_FILTERS`
    depth_mode: Literal["plane", "front", "center"] = "plane"  # how depth is read, see `gsjax.rendering`
    background: Literal["white", "black", "random"] = "black"

    def __post_init__(self):
        declare_types(self)
        check_lowest(self, max_gaussians=1, far_points=0, stereo_points=0)
        if not 0 <= self.sh_degree <= 4:
            raise ValueError(f"sh_degree={self.sh_degree} is not 0 to 4")


@dataclass(frozen=True)
class Schedule:
    """What runs when."""

    phases: tuple[Phase, ...] = PAPER_PHASES
    views_per_step: int = 1  # photos whose mean loss a step descends; what counts in steps here counts in photos then
    sh_every: int = 1000  # steps between the bands of the ramp
    vanilla: bool = False  # vanilla 3DGS for the same number of steps: no entropy, no cull, no normals, no stereo
    sparse_views: bool = False  # photos far apart are regularized (`gsjax.planning.sparse_views`)
    dropout: float = 0.0  # share of the Gaussians that each step leaves out, for few photos far apart

    def __post_init__(self):
        declare_types(self)
        check_lowest(self, views_per_step=1, sh_every=1)
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout={self.dropout} is not at least 0 and below 1")
        if not self.phases:
            raise ValueError("there are no phases")
        if not self.steps:
            raise ValueError("the phases have no steps")

    @property
    def steps(self) -> int:
        """Of all phases."""
        return sum(phase.steps for phase in self.phases)


@dataclass(frozen=True)
class EffectChoice:
    """What photography added to the scene, to be simulated."""

    names: str = NONE  # "none"; "auto", those that the photos show; or names, as in "exposure,vignetting"
    sky: str | None = None  # folder of masks, 0 where photos show sky, or "auto": it must be visible

    def __post_init__(self):
        declare_types(self)
        named_effects(self.names)


MOVED: Mapping[str, str] = {
    **{
        field.name: f"{group}.{field.name}"
        for group, record in {
            "photos": Photos, "supervision": Supervision, "model": Model, "schedule": Schedule, "effects": EffectChoice
        }.items()
        for field in fields(record)
    },
    "photos": "photos.subset",
    "effects": "effects.names",
}  # fmt: skip
"""Keys of settings that had no groups -> where they are."""


def group_flat(data: Mapping[str, Any]) -> dict[str, Any]:
    """A table of settings whose keys that have moved are in their groups, as `config.json` of earlier versions."""
    is_flat = {key: key in MOVED and not isinstance(value, Mapping) for key, value in data.items()}
    grouped = {key: value for key, value in data.items() if not is_flat[key]}
    for key in (key for key in data if is_flat[key]):
        group, name = MOVED[key].split(".")
        grouped[group] = {**grouped.get(group, {}), name: data[key]}
    return grouped


@dataclass(frozen=True)
class Settings:
    """A training run."""

    moved = MOVED
    seed: int = 0
    photos: Photos = Photos()
    supervision: Supervision = Supervision()
    model: Model = Model()
    schedule: Schedule = Schedule()
    effects: EffectChoice = EffectChoice()
    rates: Rates = Rates()
    density: Density = Density()
    logging: Logging = Logging()

    def __new__(cls, *_: Any, **options: Any) -> Self:
        """Refuse keys that a group has now."""
        refuse_moved(cls, options, where="Settings")
        return super().__new__(cls)

    def __post_init__(self):
        declare_types(self)
        check_seed(self.seed)
        if self.supervision.depth is not None and self.schedule.vanilla:
            raise ValueError("vanilla is plain 3DGS, which has no term for depth: leave one of the two out")

    def replace(self, **changes: Any) -> Self:
        """These settings with other values; a table changes those fields of a group that it names."""
        tables = {name: change for name, change in changes.items() if isinstance(change, Mapping)}
        groups = {name: replace(getattr(self, name), **table) for name, table in tables.items()}
        return replace(self, **changes | groups)
