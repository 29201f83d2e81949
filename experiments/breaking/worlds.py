"""The same photos in other worlds: far off, in other units, turned. The results are the same, where their user is."""

import json
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

from breaking.commands import Command, Rows, environment, finished, start_command

TITLE = "Similarities of the world"
COLUMNS = "World", "PSNR", "SSIM", "Mesh to that at the origin"
UTM = "500000, 4500000, 100"
HERE = "1.0", "0, 0, 0", "0, 0, 0"
AGAIN = "as it is, another seed"
WORLDS = {
    "as it is": HERE,
    AGAIN: HERE,
    "UTM: (5e5, 4.5e6, 100) further": ("1.0", UTM, "0, 0, 0"),
    "geocentric: (4e6, 6e5, 5e6) further": ("1.0", "4e6, 6e5, 5e6", "0, 0, 0"),
    "a thousandth as large": ("0.001", "0, 0, 0", "0, 0, 0"),
    "a thousand times as large": ("1000.0", "0, 0, 0", "0, 0, 0"),
    "a millionth as large": ("1e-6", "0, 0, 0", "0, 0, 0"),
    "a million times as large": ("1e6", "0, 0, 0", "0, 0, 0"),
    "a hundred times as large, at UTM": ("100.0", UTM, "0, 0, 0"),
    "turned": ("1.0", "0, 0, 0", "0.3, -1.1, 0.7"),
    "turned another way": ("1.0", "0, 0, 0", "-1.3, 0.4, 0.9"),
}
SETTINGS = "schedule.phases.0.steps=600", "density.stop=420", "model.max_gaussians=4000", "model.sh_degree=1"
SCENE = """
from gsjax.io import analytic_scene
analytic_scene.write_built_in_scene("here", num_views=24, size=(96, 72))
"""
MOVED = """
import sys
from pathlib import Path
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

scale, shift, turn = eval(sys.argv[1]), np.array(eval(sys.argv[2])), Rotation.from_rotvec(eval(sys.argv[3])).as_matrix()
model = pycolmap.Reconstruction(sys.argv[4] + "/sparse/0")
for image in model.images.values():
    pose = image.cam_from_world().matrix()
    left, _, right = np.linalg.svd(pose[:, :3])  # Rotations of float32 are none at 4,500,000.
    rotation = left @ right @ turn.T
    there = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), scale * pose[:, 3] - rotation @ shift)
    image.frame.set_cam_from_world(image.camera_id, there)
for point in model.points3D.values():
    point.xyz = scale * turn @ point.xyz + shift
model.write_binary(sys.argv[4] + "/sparse/0")
"""
APART = """
import sys
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from gsjax.meshing.export import read_mesh

scale, shift, turn = eval(sys.argv[1]), np.array(eval(sys.argv[2])), Rotation.from_rotvec(eval(sys.argv[3])).as_matrix()
here, there = (read_mesh(file).vertices.astype(np.float64) for file in sys.argv[4:])
back = (there - shift) / scale @ turn
print(max(np.median(cKDTree(a).query(b)[0]) for a, b in ((here, back), (back, here))))
"""


def rows(folder: Path) -> Rows:
    """A row a world."""
    return {world: [partial(_scores, folder / "elsewhere", world)] for world in WORLDS}


def _scores(folder: Path, world: str) -> list[str]:
    """What a training comes to there, and how far its mesh is from that of the scene at the origin."""
    if not (folder / "here_run.ply").exists():
        folder.mkdir(exist_ok=True)
        _python(folder, SCENE)
        _trained(folder, "here", "here_run", seed=0)
    for name in ("there", "there_run"):
        shutil.rmtree(folder / name, ignore_errors=True)
    for name in ("images", "sparse"):
        shutil.copytree(folder / "here" / name, folder / "there" / name)
    _python(folder, MOVED, *WORLDS[world], "there")
    _trained(folder, "there", "there_run", seed=int(world == AGAIN))
    manifest = json.loads((folder / "there_run/manifest.json").read_text())
    apart = float(_python(folder, APART, *WORLDS[world], "here_run.ply", "there_run.ply"))
    return [f"{manifest['psnr']:.2f}", f"{manifest['ssim']:.3f}", f"{apart:.4f}"]


def _trained(folder: Path, scene: str, run: str, *, seed: int) -> None:
    """Leaves a run and its mesh."""
    train = ("train", scene, "--preset", "quick", "--effects", "none", "--set", *SETTINGS, f"seed={seed}", "--out")
    for arguments, out in ((train, run), (("mesh", run, "--out"), f"{run}.ply")):
        code, stderr = finished(start_command(folder, Command(arguments, out), out))
        assert code == 0, stderr[-2000:]


def _python(folder: Path, program: str, *arguments: str) -> str:
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(
        command, cwd=folder, env=environment(folder), check=True, capture_output=True, text=True
    ).stdout
