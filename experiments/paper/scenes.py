"""The scenes of the paper, the methods of its tables as schedules, and where published data sets have the scenes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from gsjax import config
from gsjax.errors import InputError
from gsjax.presets import REFINED_BY, preset
from gsjax.settings import Settings

INDOOR, OUTDOOR = "Mip-NeRF 360, indoor", "Mip-NeRF 360, outdoor"
TANKS, BLENDING = "Tanks & Temples", "Deep Blending"


class PaperScene(NamedTuple):
    """One scene: its part of a table, which of its published photos are used, and R's weight."""

    part: str
    images: str
    lambda_r: float = 0.2  # The paper tunes it, between 0.1 and 0.4, and prints no scene's value.


# The folders that 3DGS and SuGaR read: half size indoors, a quarter outdoors, the others as they come.
SCENES: dict[str, PaperScene] = {
    "room": PaperScene(INDOOR, "images_2"),
    "counter": PaperScene(INDOOR, "images_2"),
    "kitchen": PaperScene(INDOOR, "images_2"),
    "bonsai": PaperScene(INDOOR, "images_2"),
    "bicycle": PaperScene(OUTDOOR, "images_4"),
    "garden": PaperScene(OUTDOOR, "images_4"),
    "stump": PaperScene(OUTDOOR, "images_4"),
    "truck": PaperScene(TANKS, "images"),
    "train": PaperScene(TANKS, "images"),
    "drjohnson": PaperScene(BLENDING, "images"),
    "playroom": PaperScene(BLENDING, "images"),
}
NESTS = ("", "360_v2", "tandt", "db", "tandt_db/tandt", "tandt_db/db")
"""Where under a root the archives' scenes may be: of Mip-NeRF 360, and of 3DGS's `tandt_db`."""

SHARED: dict[str, Any] = {
    # The published files are of the size that is scored.
    "photos": {"downscale": 1, "hold_out": "8"},
    # No cap that is meant to bind: 3DGS's rule has none. Buffers hold what is alive and double as it grows, so a high
    # number costs nothing. 16 million rows are 11 GB of state and moments.
    "model": {"max_gaussians": 16_000_000},
}


class Schedule(NamedTuple):
    """A method of the tables: what differs from a preset of the training."""

    preset: str
    regulariser: str | None  # what the last phase has beside the image's terms; None: nothing, and no refinement
    differences: Mapping[str, Any] = {}

    @property
    def refinement(self) -> str | None:
        """The preset of the refinement that follows."""
        return REFINED_BY[self.preset] if self.regulariser else None


PAPER_MESH: dict[str, Any] = {
    "level": 0.3,
    "points": 10_000_000,
    "depth": 10,
    "trim_quantile": 0.1,
    "photo_refine": False,
    "keep_floaters": True,
}
"""Options of `gsjax.pipeline.mesh` for every method: the paper extracts all of its meshes by SuGaR's technique.

docs/deviations.md names what still differs from SuGaR's own code.
"""

R, SUGAR = "R", "SuGaR's terms"
SCHEDULES: dict[str, Schedule] = {
    "3dgs_30k": Schedule(
        "paper_6k_15k", None, {"schedule": {"phases": [{"name": "vanilla", "steps": 30_000, "density_control": True}]}}
    ),
    "vanilla": Schedule("paper_6k_15k", None, {"schedule": {"vanilla": True}}),
    "sugar": Schedule(
        "paper_6k_15k",
        SUGAR,
        {"schedule": {"phases": {"surface": {"weights": {"sdf_normal": 0.0, "sugar_sdf": 0.2}}}}},
    ),
    "paper_6k_15k": Schedule("paper_6k_15k", R),
    "paper_13k_7k": Schedule("paper_13k_7k", R),
}
"""`vanilla` is no row of the paper: `paper_6k_15k` without entropy, cull and R, for meshes and scores without them.

`3dgs_30k` grows up to step 15,000, as the authors' code does. `sugar` reads the terms of `experiments/terms`.
"""
DEFAULT_SCHEDULES = ("paper_6k_15k", "paper_13k_7k")


def parts() -> dict[str, tuple[str, ...]]:
    """The scenes of every part of the tables, in the paper's order."""
    return {part: tuple(n for n, s in SCENES.items() if s.part == part) for part in (INDOOR, OUTDOOR, TANKS, BLENDING)}


def settings_of(scene: str, schedule: str, seed: int, assignments: Sequence[str] = ()) -> Settings:
    """The training of one run: the schedule's, what all share, the scene's photos and lambda_r, then assignments.

    Raises:
        InputError: An assignment's key is unknown, or its value wrong.
    """
    plan, place = SCHEDULES[schedule], SCENES[scene]
    own: dict[str, Any] = {"photos": {"images": place.images}, "seed": seed}
    if plan.regulariser == R:
        own["schedule"] = {"phases": {"surface": {"weights": {"sdf_normal": place.lambda_r}}}}
    whole = config.to_dict(preset(plan.preset, config.merge(SHARED, plan.differences, own)))
    return config.parse(Settings, config.override(whole, assignments), where="--set")


def discover(root: str | Path) -> tuple[dict[str, Path], list[str]]:
    """The paper's scenes under a root.

    Returns:
        Folders by name, in the paper's order; and a line for every folder that has a scene's name but cannot be it.

    Raises:
        InputError: There is no such root, none of the scenes is there, or one of them is there twice.
    """
    from gsjax.io.scenes import is_data_set

    root = Path(root)
    if not root.is_dir():
        raise InputError(f"{root}: no such folder")
    folders: dict[str, Path] = {}
    faults: list[str] = []
    for name, scene in SCENES.items():
        for folder in (root / nest / name for nest in NESTS):
            if not folder.is_dir():
                continue
            if not is_data_set(folder):
                faults.append(f"{folder}: is no data set, left out")
            elif not (folder / scene.images).is_dir():
                faults.append(f"{folder}: has no {scene.images}/, which the paper's tables are of; left out")
            elif name in folders:
                raise InputError(f"{root}: {name} is there twice, as {folders[name]} and as {folder}")
            else:
                folders[name] = folder
    if not folders:
        nests = ", ".join(nest for nest in NESTS if nest)
        reason = f"; {faults[0]}" if faults else ""
        raise InputError(f"{root}: holds none of {', '.join(SCENES)}, neither itself nor in {nests}{reason}")
    return folders, faults
