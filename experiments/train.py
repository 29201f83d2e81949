"""What does a run with a config of `configs.py` reach? Trains, meshes and scores a scene.

    python experiments/train.py CONFIG --scene PATH --out RUN [--set KEY=VALUE ...]

Prints the figures of photos and mesh, and writes them as `RUN/evaluation.json`; `RUN/manifest.json` holds machine,
versions, seed and commit.
"""

import argparse
import difflib
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from configs import CONFIGS

from gsjax import config
from gsjax.cli import run_guarded
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.report import tables
from gsjax.settings import Settings


def run(name: str, scene: str, out: str, assignments: Sequence[str] = ()) -> dict:
    """Trains `scene` with a config, extracts the mesh, scores both; `OUT/evaluation.json` holds what is returned."""
    from gsjax import pipeline  # Here, and not above: it imports jax, whose environment `run_guarded` sets first.

    pipeline.train(scene, out, load_settings(name, assignments))
    mesh = Path(out) / "mesh.ply"
    pipeline.mesh(out, mesh)
    figures = pipeline.evaluate(out, mesh=mesh)
    json_files.write(Path(out) / "evaluation.json", figures)
    return figures


def load_settings(name: str, assignments: Sequence[str] = ()) -> Settings:
    """The settings of a config: `base`, the config's differences, then `key=value` assignments.

    Raises:
        InputError: There is no such config, or a key of it is unknown or its value wrong.
    """
    whole = config.to_dict(config.parse(Settings, load_config(name), where=f"config {name}"))
    return config.parse(Settings, config.override(whole, assignments), where="--set")


def load_config(name: str) -> dict:
    """A whole config: `base` with the differences of the named one.

    Raises:
        InputError: There is no such config.
    """
    if name not in CONFIGS:
        raise InputError(f"no config '{name}'; the nearest is '{nearest(name, CONFIGS)}'")
    return config.merge(CONFIGS["base"], CONFIGS[name])


def claim(out: Path, request: Mapping[str, Any]) -> None:
    """Notes what a folder's runs are of, as `OUT/asked.json`.

    Raises:
        InputError: The folder holds runs of something else.
    """
    note = out / "asked.json"
    before = json_files.read(note) if note.exists() else request
    for key, value in request.items():
        if before[key] != value:
            raise InputError(f"{note}: its runs are of {key} {before[key]}, not {value}; --out takes another folder")
    out.mkdir(parents=True, exist_ok=True)
    json_files.write(note, request)


def nearest(name: str, names: Iterable[str]) -> str:
    """The known name that is most like this one."""
    return max(names, key=lambda other: difflib.SequenceMatcher(None, name, other).ratio())


def main() -> None:
    """Reads the arguments and prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", metavar="CONFIG", help=", ".join(CONFIGS))
    parser.add_argument("--scene", required=True, help="folder of the data set")
    parser.add_argument("--out", required=True, metavar="RUN", help="empty folder for the run")
    parser.add_argument("--set", nargs="+", default=[], metavar="KEY=VALUE", help="settings by their dotted keys")
    arguments = parser.parse_args()
    print(tables.record(run(arguments.config, arguments.scene, arguments.out, arguments.set)))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
