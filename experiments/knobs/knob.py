"""What a knob is, and the place where knobs are turned."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from gsjax import pipeline
from gsjax.config import merge, parse
from gsjax.io.scenes import load_scene
from gsjax.runs.result import Result, open_result
from gsjax.settings import Settings


class Measured(NamedTuple):
    """One setting, tried once."""

    seconds: float
    outcome: Any  # whatever the knob's `errors` compares


@dataclass(frozen=True)
class Knob:
    """Settings of one thing, and how each is measured."""

    values: Mapping[str, Any]  # by their labels, the most accurate first
    measure: Callable[["Place", Any, int], Measured]  # (where, a value, the round)
    errors: Callable[[Any, Any], dict[str, float]]  # (outcome, that of the most accurate) -> error by its unit


class Place:
    """A data set, a folder for runs, and a run that rendering and surface knobs start from."""

    def __init__(self, scene: str | Path, out: str | Path, config: Mapping[str, Any], share: float):
        """Trains nothing yet.

        Args:
            scene: Data set; its `normals` are used where it has them.
            out: Folder for the runs.
            config: A whole one, which knobs are differences from.
            share: Of its steps, in every run.
        """
        self.scene, self.out, self.config, self._share = Path(scene), Path(out), config, share

    @cached_property
    def has_truth(self) -> bool:
        """Whether the data set has a true surface."""
        return load_scene(self.scene).truth is not None

    def settings(self, difference: Mapping[str, Any], seed: int) -> Settings:
        """The config's settings with a difference, in this place's share of the steps."""
        normals = self.scene / "normals"
        given = {"seed": seed} | ({"normals": str(normals)} if normals.is_dir() else {})
        return pipeline.scaled(parse(Settings, merge(self.config, given, difference)), self._share)

    def fresh(self, name: str) -> Path:
        """A folder of this place that does not exist yet."""
        folder = self.out / "runs" / name
        shutil.rmtree(folder, ignore_errors=True)
        return folder

    @cached_property
    def run(self) -> Path:
        """The run that others start from, trained once."""
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

    @cached_property
    def result(self) -> Result:
        """Its Gaussians and cameras."""
        return open_result(self.run)
