"""Trains, meshes and scores one scene with a config of `configs/`."""

import argparse
import difflib
import runpy
import sys
from collections.abc import Sequence
from pathlib import Path

from gsjax import config, tables
from gsjax.cli import guarded
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.settings import Settings

CONFIGS = Path(__file__).parent / "configs"


def run(name: str, scene: str, out: str, assignments: Sequence[str] = ()) -> dict:
    """Trains `scene` with a config, extracts the mesh, scores both; `OUT/evaluation.json` holds what is returned."""
    from gsjax import pipeline  # Here, and not above: it imports jax, whose environment `guarded` settles first.

    pipeline.train(scene, out, load_settings(name, assignments))
    mesh = Path(out) / "mesh.ply"
    pipeline.mesh(out, mesh)
    figures = pipeline.evaluate(out, mesh=mesh)
    json_files.write(Path(out) / "evaluation.json", figures)
    return figures


def load_settings(name: str, assignments: Sequence[str] = ()) -> Settings:
    """The settings of `configs/NAME.py`: `base.py`, the config's differences, then `key=value` assignments.

    Raises:
        InputError: There is no such config, or a key of it is unknown or its value wrong.
    """
    merged = config.merge(load_config("base"), load_config(name))
    whole = config.to_dict(config.parse(Settings, merged, where=f"configs/{name}.py"))
    return config.parse(Settings, config.override(whole, assignments), where="--set")


def load_config(name: str, *, folder: Path = CONFIGS) -> dict:
    """The `CONFIG` of `NAME.py` in a folder."""
    path = folder / f"{name}.py"
    if not path.is_file():
        known = sorted(p.stem for p in folder.glob("*.py"))
        nearest = max(known, key=lambda other: difflib.SequenceMatcher(None, name, other).ratio())
        raise InputError(f"no config '{name}' in {folder}; the nearest is '{nearest}'")
    return runpy.run_path(str(path))["CONFIG"]


def main() -> None:
    """Reads the arguments and prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("config", metavar="CONFIG", help="name of a file in configs/, without .py")
    parser.add_argument("--scene", required=True, help="folder of the data set")
    parser.add_argument("--out", required=True, metavar="RUN", help="empty folder for the run")
    parser.add_argument("--set", nargs="+", default=[], metavar="KEY=VALUE", help="settings by their dotted keys")
    arguments = parser.parse_args()
    print(tables.record(run(arguments.config, arguments.scene, arguments.out, arguments.set)))


if __name__ == "__main__":
    sys.exit(guarded(main))
