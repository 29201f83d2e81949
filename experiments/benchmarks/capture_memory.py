"""How much memory and time does every stage of a large capture take: many photos of ordinary size?

    python experiments/benchmarks/capture_memory.py --out DIR [--photos 300] [--size 1600 1060]

The photos are those of the built-in scene, rendered small and enlarged, beside a COLMAP model of the small size: what
happens to them does not depend on what they show. Few training steps are taken: memory does not grow with them. Every
stage is one command in a process of its own.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from gsjax import tables
from gsjax.cli import run_guarded
from gsjax.io.machine import machine, versions

ENLARGED = 4
# Two phases, the second of which asks for normals: their memory is what is looked for, not a result.
PHASES = [
    {"name": "vanilla", "steps": 8, "density_control": True},
    {"name": "surface", "steps": 4, "weights": {"sdf_normal": 0.05, "pixel_normal": 0.05}},
]


def run(out: Path, *, photos: int, size: tuple[int, int]) -> dict[str, dict[str, Any]]:
    """Seconds and peak memory of each stage; a stage that is done already is not done again."""
    scene, report = out / "scene", out / "capture.json"
    stages = json.loads(report.read_text()) if report.exists() else {}
    if not scene.exists():
        _write_scene(scene, photos, size)
    train = [str(scene), "--images", "large", "--downscale", "1", "--preset", "fast", "--background", "white"]
    train += ["--set", f"phases={json.dumps(PHASES)}", "logging.evaluate_every=0"]
    commands = {
        "train, own normals": ["train", *train, "--out", str(out / "own")],
        "train, normals given": ["train", *train, "--out", str(out / "given"), "--normals", str(scene / "maps")],
        "mesh": ["mesh", str(out / "own"), "--out", str(out / "own/mesh.ply")],
        "refine": ["refine", str(out / "own"), "--out", str(out / "refined"), "--steps", "8", "--faces", "30000"],
        "texture": ["texture", str(out / "refined"), "--mesh", str(out / "refined/mesh.ply"),
                    "--out", str(out / "mesh.glb")],
    }  # fmt: skip
    for name, command in commands.items():
        if name not in stages:
            print(f"== {name}", file=sys.stderr, flush=True)
            stages[name] = _measured(command)
            report.write_text(json.dumps(stages, indent=2) + "\n")
    return stages


def _measured(command: list[str]) -> dict[str, Any]:
    """Runs one command of gsjax; its seconds and the most memory that it held."""
    started = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-m", "gsjax", *command], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"gsjax {' '.join(command)} ended with {os.waitstatus_to_exitcode(status)}")
    return {
        "seconds": round(time.perf_counter() - started, 1),
        "cpu_seconds": round(usage.ru_utime + usage.ru_stime, 1),
        "peak_gib": round(usage.ru_maxrss / 2**20, 2),
    }


def _write_scene(scene: Path, photos: int, size: tuple[int, int]) -> None:
    """The built-in scene with its photos enlarged in `large/`, and its normals as maps in `maps/`."""
    import cv2
    import numpy as np

    from gsjax.io import analytic_scene

    small = (size[0] // ENLARGED, size[1] // ENLARGED)
    analytic_scene.write(scene, num_views=photos, size=small)
    for folder in ("large", "maps"):
        (scene / folder).mkdir()
    for file in sorted((scene / "images").iterdir()):
        picture = cv2.resize(cv2.imread(str(file)), size, interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(scene / "large" / file.name), picture)
        with np.load(scene / "normals" / f"{file.stem}.npz") as maps:
            np.save(scene / "maps" / f"{file.stem}.npy", maps["cam"])
    for folder in ("depth", "normals"):  # Of the small photos.
        shutil.rmtree(scene / folder)


def main() -> None:
    """Measure and print one table, with machine and versions."""
    # A script beside this one has the name of the package.
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for the capture and its runs, about 3 GiB")
    parser.add_argument("--photos", type=int, default=300)
    parser.add_argument("--size", type=int, nargs=2, default=(1600, 1060), metavar=("W", "H"))
    arguments = parser.parse_args()
    stages = run(arguments.out, photos=arguments.photos, size=tuple(arguments.size))
    print(tables.compare(stages))
    print(tables.record({**machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
