"""What does one more number a Gaussian bring to R: an opacity for geometry alone, or a confidence in the normals?

    python experiments/perturb_normals.py SCENE
    python experiments/own_channel.py --scene SCENE --out DIR [--seeds 3] [--maps true ...]

The demo's config, whose harmonics have one band more to lend the number (`terms/spare_channel.py`). With an opacity of
their own, normals and meshes are read off Gaussians of these opacities, and pictures off those of the others.
"""

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from train import claim, load_config

from gsjax import config, tables
from gsjax.cli import run_guarded
from gsjax.io import json_files
from gsjax.settings import Settings

SURFACE = ("normal_error_deg", "normal_error_all_deg", "chamfer", "fscore")
MAPS = {"true": "normals", "20 degrees": "normals_20deg", "a fifth wrong": "normals_fifth_wrong"}
TERMS_OF_R = ("undoubted", "own_opacity", "believed", "pixel_normal")
SH_EVERY = 334  # Of the demo's 1,000 steps: the last band, which lends the number, is never shown.


def settings(term: str, maps: Path, seed: int) -> Settings:
    """The demo's, with R by a term of `TERMS_OF_R`."""
    base = load_config("demo")
    plain, surface = base["phases"]
    weights = dict(surface["weights"])
    weights[term] = weights.pop("pixel_normal")
    changed = {
        "phases": [plain, surface | {"weights": weights}],
        "sh_degree": base["sh_degree"] + 1,
        "sh_every": SH_EVERY,
        "normals": str(maps),
        "seed": seed,
    }
    return config.parse(Settings, {**base, **changed})


def run(scene: Path, out: Path, seeds: int, kinds: Sequence[str]) -> dict[str, list[dict[str, Any]]]:
    """Figures of every term on every kind of maps, a row a seed; what is done is not done again."""
    claim(out, {"scene": str(scene.resolve())})
    every: dict[str, list[dict[str, Any]]] = {}
    for seed in range(seeds):
        for kind in kinds:
            maps = MAPS[kind]
            for term in TERMS_OF_R:
                folder = out / f"{term}_{maps}_{seed}"
                if not (folder / "own_channel.json").exists():
                    print(f"== {folder.name}", flush=True)
                    json_files.write(folder / "own_channel.json", _figures(scene, folder, term, scene / maps, seed))
                every.setdefault(f"{term}, {kind}", []).append(json_files.read(folder / "own_channel.json"))
    json_files.write(out / "own_channel.json", every)
    return every


def _figures(scene: Path, folder: Path, term: str, maps: Path, seed: int) -> dict[str, Any]:
    from terms import TERMS
    from terms.spare_channel import as_geometry, without

    from gsjax import pipeline

    shutil.rmtree(folder, ignore_errors=True)
    pipeline.train(scene, folder, settings(term, maps, seed), terms=TERMS)
    drawn = pipeline.evaluate(_rewritten(folder, "drawn", without))
    shape = _rewritten(folder, "shape", as_geometry if term == "own_opacity" else without)
    pipeline.mesh(shape, shape / "mesh.ply")
    surface = pipeline.evaluate(shape, mesh=shape / "mesh.ply")
    return {"psnr": drawn["psnr"], "ssim": drawn["ssim"], **{key: surface[key] for key in SURFACE}}


def _rewritten(run: Path, name: str, change: Any) -> Path:
    """A copy of a run whose Gaussians are others."""
    from gsjax.io.ply import read_gaussians, write_gaussians

    copy = run / name
    shutil.copytree(run, copy, ignore=shutil.ignore_patterns("drawn", "shape", "checkpoints"))
    write_gaussians(copy / "gaussians.ply", change(read_gaussians(run / "gaussians.ply")))
    return copy


def main() -> None:
    """Train what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=Path, required=True, help="built-in scene, with the maps of perturb_normals.py")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the runs")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--maps", nargs="+", choices=MAPS, default=list(MAPS), help="kinds of normals (default: all)")
    given = parser.parse_args()
    every = run(given.scene, given.out, given.seeds, given.maps)
    print(tables.compare({variant: tables.spread(rows) for variant, rows in every.items()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
