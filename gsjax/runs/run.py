"""A run folder, read: each file on first access, and once."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from gsjax import runs
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.files import finish_replacement
from gsjax.io.georeference_files import read_place
from gsjax.runs.photo_effects import PhotoEffects, read_photo_effects
from gsjax.runs.records import MANIFEST, PLAN, read_views
from gsjax.runs.splits import Split, parse_split
from gsjax.scene.georeference import Place
from gsjax.scene.similarity import Similarity
from gsjax.training.plan import plan_record


@dataclass(frozen=True)
class Run:
    """What the files of a run folder say."""

    folder: Path

    @classmethod
    def open(cls, folder: str | Path) -> Self:
        """The run in a folder; InputError where there is none."""
        folder = Path(folder)
        if not folder.exists():
            raise InputError(f"{folder}: no such folder")
        finish_replacement(folder)
        if not (folder / "manifest.json").is_file():
            raise InputError(f"{folder}: holds no manifest.json; it is no run folder")
        return cls(folder)

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """Scene, command, versions, state, and what each stage left."""
        return json_files.read(self.folder / "manifest.json", MANIFEST)

    @cached_property
    def settings(self) -> dict[str, Any]:
        """The settings."""
        return runs.read_settings(self.folder)

    @cached_property
    def plan(self) -> dict[str, Any]:
        """The phases that run, see `gsjax.training.plan.plan_record`; none of a run that wrote no plan."""
        file = self.folder / "plan.json"
        if file.exists():
            return json_files.read(file, PLAN)
        downscale = self.settings["photos"].get("downscale") or 1.0
        return plan_record([], downscale, self.settings["supervision"].get("normals"))

    @cached_property
    def views(self) -> list[dict[str, Any]]:
        """The records of cameras.json; none before the run has finished."""
        return read_views(self.folder) if (self.folder / "cameras.json").exists() else []

    @cached_property
    def split(self) -> Split:
        """Names of the photos, and which are held out; empty for an unfinished run of a version that stored none."""
        if "split" in self.manifest:
            return parse_split(self.manifest["split"])
        return {record["name"]: bool(record["held_out"]) for record in self.views}

    @cached_property
    def metrics(self) -> list[dict[str, Any]]:
        """The lines of metrics.jsonl."""
        return runs.read_metrics(self.folder)

    @cached_property
    def photo_effects(self) -> PhotoEffects:
        """What it found of how its photos were taken."""
        return read_photo_effects(self.folder)

    @cached_property
    def similarity(self) -> Similarity:
        """To the coordinates of its checkpoints from those of its other files."""
        return runs.read_similarity(self.folder)

    @cached_property
    def place(self) -> Place:
        """To the world, which its other files are in, from the coordinates of its data set."""
        return read_place(self.folder)

    @property
    def is_refinement(self) -> bool:
        """Whether a mesh was trained with its Gaussians here."""
        return "refinement" in self.settings

    @property
    def downscale(self) -> float:
        """Factor by which the photos were downscaled; InputError where it is not positive."""
        factor = float(self.plan["downscale"])
        if not factor > 0:
            raise InputError(f"{self.folder}: its plan has downscale {factor:g}, which is not positive")
        return factor
