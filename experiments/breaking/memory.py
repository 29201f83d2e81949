"""How much memory readers take, in times of what they return."""

import subprocess
import sys
from functools import partial
from pathlib import Path

from breaking.commands import Rows, environment

TITLE = "Memory of readers"
COLUMNS = "Read", "File, MB", "Returned, MB", "Most taken meanwhile, in times of it"
GAUSSIANS = """
from gsjax.gaussians import Gaussians
from gsjax.io.gaussian_files import load_gaussians as read, save_gaussians
normal = lambda *shape: rng.normal(size=(400_000, *shape)).astype(np.float32)
made = Gaussians(normal(3), normal(4), normal(3) - 3, normal(), normal(1, 3), normal(15, 3))
save_gaussians(made, file)
"""
POINTS = """
from gsjax.io.ply import read_points as read
import trimesh
trimesh.PointCloud(rng.normal(size=(2_000_000, 3)), np.zeros((2_000_000, 4), np.uint8)).export(file)
"""
MODEL = """
import pycolmap
from gsjax.io.colmap import read_model as read
model = pycolmap.Reconstruction()
camera = pycolmap.Camera(camera_id=1, model="PINHOLE", width=400, height=400, params=(300, 300, 200, 200))
model.add_camera_with_trivial_rig(camera)
for i in range(40):
    image = pycolmap.Image(f"{i}.png", rng.uniform(0, 400, (5_000, 2)), 1, i + 1)
    model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
for i in range(100_000):
    track = [pycolmap.TrackElement(1 + i // 5_000 + k, i % 5_000) for k in (0, 20)]
    model.add_point3D(rng.normal(size=3), pycolmap.Track(track), np.zeros(3, np.uint8))
file.mkdir()
model.write_KIND(file)
"""
PHOTO = """
from PIL import Image
from gsjax.io.images import read_image as read
Image.fromarray(np.resize(rng.integers(0, 256, 10**6), (6_000, 10_000, 3)).astype(np.uint8)).save(file)
"""
ARRAYS = """
from gsjax.io.arrays import read_arrays as read
np.savez(file, cam=rng.normal(size=(5_000, 2_000, 3)).astype(np.float32))
"""
MESH = """
from gsjax.scene.meshes import Mesh
from gsjax.meshing.export import read_mesh as read, write_mesh
faces = rng.integers(0, 500_000, (1_000_000, 3)).astype(np.int32)
vertices, colors = rng.normal(size=(500_000, 3)), rng.uniform(size=(500_000, 3))
write_mesh(file, Mesh(vertices.astype(np.float32), faces, colors.astype(np.float32)))
"""
LISTED = """
import json
from gsjax.io.json_files import read
file.write_text(json.dumps({"frames": rng.normal(size=(100_000, 4, 4)).tolist()}))
"""
FILES = {
    "Gaussians, `.ply`": ("g.ply", GAUSSIANS),
    "Gaussians, `.compressed.ply`": ("g.compressed.ply", GAUSSIANS),
    "Gaussians, `.spz`": ("g.spz", GAUSSIANS),
    "Points, `.ply`": ("p.ply", POINTS),
    "COLMAP model, binary": ("binary", MODEL.replace("KIND", "binary")),
    "COLMAP model, text": ("text", MODEL.replace("KIND", "text")),
    "JSON, 1.6 million numbers": ("numbers.json", LISTED),
    "Photo of 60 megapixels, PNG": ("photo.png", PHOTO),
    "Photo of 60 megapixels, JPEG": ("photo.jpg", PHOTO),
    "Arrays, `.npz`": ("a.npz", ARRAYS),
    "Mesh, `.ply`": ("mesh.ply", MESH),
    "Mesh, `.obj`": ("mesh.obj", MESH),
    "Mesh, `.glb`": ("mesh.glb", MESH),
}
READ = """
import sys
from pathlib import Path
import numpy as np

file, rng = Path(sys.argv[1]), np.random.default_rng(0)
WRITE
import os
import dataclasses
from gsjax.io.machine import peak_memory, restart_peak_memory

def size(value):
    if isinstance(value, np.ndarray):
        return value.nbytes
    if dataclasses.is_dataclass(value):
        return sum(size(getattr(value, field.name)) for field in dataclasses.fields(value))
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, (list, tuple)) else ()
    return sys.getsizeof(value) + sum(map(size, inner))

if len(sys.argv) > 2:
    sys.exit()
restart_peak_memory()
before = peak_memory()
found = read(file)
taken = peak_memory() - before
files = file.iterdir() if file.is_dir() else [file]
print(sum(each.stat().st_size for each in files) / 1e6, size(found) / 1e6, taken / size(found))
"""


def rows(folder: Path) -> Rows:
    """A row a kind of files."""
    return {kind: [partial(_memory_row, folder / "memory", *FILES[kind])] for kind in FILES}


def _memory_row(folder: Path, name: str, write: str) -> list[str]:
    """A process writes the file; another, which is as large as its libraries make it, reads it."""
    folder.mkdir(parents=True, exist_ok=True)
    imports = "\n".join(line for line in write.splitlines() if line.startswith(("from", "import")))
    for body, more in ((write, ["only"]), (imports, [])):
        command = [sys.executable, "-c", READ.replace("WRITE", body), name, *more]
        done = subprocess.run(command, cwd=folder, env=environment(folder), check=True, capture_output=True, text=True)
    of_file, returned, times = map(float, done.stdout.split())
    return [f"{of_file:,.0f}", f"{returned:,.0f}", f"{times:.1f}"]
