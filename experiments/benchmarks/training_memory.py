"""How much memory does a training take for a Gaussian, and for a pixel of the photo of a step?

    python experiments/benchmarks/training_memory.py --out DIR [--rows 50000 200000 800000] [--sizes 640x480 2560x1920]

The numbers of `gsjax.planning.memory`. The photos are three of the built-in scene, enlarged; the Gaussians begin on its
surfaces, half as many as may grow, so that their buffers grow as well. A few steps of an image phase and of a surface
phase are taken, each case in a process of its own; its peak counts beyond what the process held when it planned.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

from gsjax.cli import run_guarded
from gsjax.io.machine import machine, versions
from gsjax.report import tables

SMALL = (320, 240)
PHASES = [
    {"name": "vanilla", "steps": 8, "density_control": True},
    {"name": "surface", "steps": 4,
     "weights": {"sdf_normal": 0.05, "pixel_normal": 0.05, "multi_view": 0.03, "photometric": 0.15}},
]  # fmt: skip
MODEL = {"depth_mode": "front", "pixel_filter": "mip"}
SETTINGS = {
    "schedule": {"phases": PHASES}, "photos": {"downscale": 1},
    "density": {"rule": "error", "start": 2, "stop": 8, "every": 2, "full_by": 0.5, "reset_every": 0},
    "logging": {"evaluate_every": 0},
}  # fmt: skip
CHILD = """
import json, re, sys
from pathlib import Path
from gsjax.cli.environment import prepare
prepare()
from gsjax import pipeline
from gsjax.io.machine import peak_memory
from gsjax.planning import memory

def held():
    return 1024 * int(re.search(r"VmRSS:\\s*(\\d+)", Path("/proc/self/status").read_text())[1])

def plenty():
    global before
    before = held()
    return 1 << 40

memory.free_memory = plenty
scene, out, settings = sys.argv[1:]
done = pipeline.train(scene, out, json.loads(settings))
print(json.dumps({"gaussians": done["gaussians"], "before": before, "peak": peak_memory()}))
"""


def measure(out: Path, rows: int, size: tuple[int, int]) -> dict[str, float]:
    """MiB of one case, beyond the photos' own."""
    scene = _scene(out / "{}x{}".format(*size), size)
    cloud = out / f"{rows}.ply"
    if not cloud.exists():
        _write_cloud(cloud, scene, rows // 2)
    run = out / "run_{}_{}x{}".format(rows, *size)
    command = [sys.executable, "-c", CHILD, str(scene), str(run), json.dumps(
        {**SETTINGS, "model": {**MODEL, "max_gaussians": rows, "points": str(cloud.resolve())}})]  # fmt: skip
    compiling = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(run) + ".programs"}  # Nobody compiled them before.
    output = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=compiling).stdout
    report = json.loads(output.splitlines()[-1])
    mib = (report["peak"] - report["before"]) / 2**20
    return {"gaussians": report["gaussians"], "megapixels": size[0] * size[1] / 1e6, "before": report["before"] / 2**20,
            "taken": mib}  # fmt: skip


def _scene(folder: Path, size: tuple[int, int]) -> Path:
    from gsjax.io import analytic_scene
    from gsjax.io.images import cv2, read_image, write_image

    if not folder.exists():
        analytic_scene.write_built_in_scene(folder, num_views=4, size=SMALL)
        for file in (folder / "images").iterdir():
            write_image(file, cv2.resize(read_image(file)[0], size, interpolation=cv2.INTER_CUBIC))
    return folder


def _write_cloud(file: Path, scene: Path, count: int) -> None:
    import numpy as np

    from gsjax.io.ply import encode_mesh
    from gsjax.scene.meshes import Mesh

    rng = np.random.default_rng(0)
    with np.load(scene / "gt_points.npz") as truth:
        points = truth["points"][rng.integers(0, len(truth["points"]), count)]
    points = (points + rng.normal(0, 0.01, points.shape)).astype(np.float32)
    grey = np.full(points.shape, 128, np.uint8)
    file.write_bytes(encode_mesh(Mesh(points, np.empty((0, 3), np.int32), grey)))


def main() -> None:
    """Measures all cases and prints them as one table, with machine and versions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for scenes and runs")
    parser.add_argument("--rows", type=int, nargs="+", default=[50_000, 200_000, 800_000])
    parser.add_argument("--sizes", nargs="+", default=["640x480", "2560x1920"], metavar="WxH")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    cases = {}
    for text in arguments.sizes:
        width, _, height = text.partition("x")
        for rows in arguments.rows:
            cases[f"{rows:,} rows, {text}"] = measure(arguments.out, rows, (int(width), int(height)))
    print(tables.compare(cases))
    print(tables.record({**machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
