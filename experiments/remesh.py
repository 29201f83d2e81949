"""How do meshes, and refinements, of the same trained runs compare?

    python experiments/remesh.py {methods,length} RUN ... --out DIR

Every variant takes every RUN's Gaussians to a mesh, and refines that where it says so; a run each is a seed. Seconds
are the processor's, compilation included, of the mesh alone or of the refinement alone. Called again it goes on after
what is done.
"""

import argparse
import hashlib
import json
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from train import nearest

from gsjax import tables
from gsjax.cli import run_guarded
from gsjax.errors import InputError
from gsjax.io import json_files

STUDIES = ("methods", "length")
FIGURES = ("psnr", "ssim", "depth_error", "normal_error_deg", "normal_error_all_deg", "chamfer", "fscore_half",
           "fscore", "mesh_normal_error_deg", "mesh_normal_error_all_deg")  # fmt: skip


def variants_of(study: str) -> dict[str, dict[str, Any]]:
    """The variants of a study by name.

    Each holds `mesh`, options of `gsjax.pipeline.mesh` (absent: the defaults), and `refine`, settings of a refinement
    (absent: there is none, and the free Gaussians are scored).

    Raises:
        InputError: There is no such study.
    """
    from gsjax.binding.refining import PRESETS

    studies: dict[str, dict[str, dict[str, Any]]] = {
        # How a mesh is made of the same Gaussians, and whether it then settles on the photos.
        "methods": {
            "poisson": {},
            "poisson, unsettled": {"mesh": {"settled": False}},
            "depth": {"mesh": {"method": "depth"}},
            "tsdf": {"mesh": {"method": "tsdf"}},
        },
        # How long a refinement takes and what it brings, beside the free Gaussians before it.
        "length": {"free": {}} | {name: {"refine": PRESETS[name]} for name in ("fast", "balanced")},
    }
    if study not in studies:
        raise InputError(f"no study '{study}' of meshes; the nearest is '{nearest(study, STUDIES)}'")
    return studies[study]


def run(study: str, sources: Sequence[str], out: str) -> dict[str, list[dict[str, Any]]]:
    """Figures of every variant, a row a run, and the true mesh's own where there is one.

    Args:
        study: As in `variants_of`.
        sources: Folders of runs, no two of one name.
        out: Folder for meshes and refinements, OUT/VARIANT_RUN each.

    Raises:
        InputError: There is no such study, two runs have one name, or OUT holds figures of other runs.
    """
    variants = variants_of(study)
    folders = {Path(source).name: Path(source).resolve() for source in sources}
    if len(folders) < len(sources):
        raise InputError(f"{', '.join(sources)}: two runs have one name, and what is made of them would have too")
    every: dict[str, list[dict[str, Any]]] = {}
    floor: dict[str, Any] = {}
    for name, source in folders.items():
        for variant, asked in variants.items():
            folder = Path(out) / f"{variant}_{name}"
            done = folder / "remesh.json"
            if not done.exists():
                print(f"== {folder.name}", flush=True)
                shutil.rmtree(folder, ignore_errors=True)
                json_files.write(done, {"run": str(source), **_measured(source, folder, Path(out), asked)})
            found = json_files.read(done)
            if found["run"] != str(source):
                raise InputError(f"{done}: is of the run {found['run']}, not of {source}; --out takes another folder")
            floor = found["floor"]
            every.setdefault(variant, []).append(found["figures"])
    return every | ({tables.FLOOR: [floor]} if floor else {})


def _measured(source: Path, folder: Path, out: Path, asked: dict[str, Any]) -> dict[str, Any]:
    """Figures of one variant of one run, and those of the true mesh."""
    from gsjax import pipeline

    mesh, seconds = _mesh(source, out / "meshes", asked.get("mesh", {}))
    scored = source
    if "refine" in asked:
        scored = folder / "refined"
        seconds = _timed(lambda: _refined(source, scored, mesh, asked["refine"]))
        mesh = scored / "mesh.ply"
    found = pipeline.evaluate(scored, mesh=mesh)
    figures, floor = ({key: f[key] for key in FIGURES if key in f} for f in (found, found.get("floor", {})))
    return {"figures": figures | {"cpu_seconds": seconds}, "floor": floor}


def _mesh(source: Path, folder: Path, options: dict[str, Any]) -> tuple[Path, float]:
    """The mesh of a run with these options, made once, and the seconds that it took."""
    from gsjax import pipeline

    name = hashlib.sha256(json.dumps([str(source), options], sort_keys=True).encode()).hexdigest()[:12]
    file, note = folder / f"{name}.ply", folder / f"{name}.json"
    if not note.exists():
        folder.mkdir(parents=True, exist_ok=True)
        seconds = _timed(lambda: pipeline.mesh(source, file, **options))
        json_files.write(note, {"run": str(source), "options": options, "cpu_seconds": seconds})
    return file, json_files.read(note)["cpu_seconds"]


def _refined(source: Path, folder: Path, mesh: Path, asked: dict[str, Any]) -> None:
    from gsjax import config, pipeline, runs
    from gsjax.binding.refining import Refinement

    seed = runs.read_settings(source)["seed"]
    pipeline.refine(source, folder, config.parse(Refinement, {**asked, "seed": seed}), mesh=mesh)


def _timed(stage: Callable[[], object]) -> float:
    """Seconds of the processor."""
    started = time.process_time()
    stage()
    return time.process_time() - started


def main() -> None:
    """Reads the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=STUDIES, help="what is compared")
    parser.add_argument("runs", metavar="RUN", nargs="+", help="run folders, one a seed")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for meshes and refinements")
    arguments = parser.parse_args()
    every = run(arguments.study, arguments.runs, arguments.out)
    print(tables.compare({variant: tables.spread(rows) for variant, rows in every.items()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
