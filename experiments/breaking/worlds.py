"""The same photos in other worlds: far off, in other units, turned. The results are the same, where their user is."""

import json
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

from breaking.commands import COMMANDS, Rows, begun, environment, finished, whole

TITLE = "Similarities of the world"
COLUMNS = "World", "PSNR", "SSIM", "Mesh to that at the origin"
UTM = "500000, 4500000, 100"
WORLDS = {
    "as it is": ("1.0", "0, 0, 0", "0, 0, 0"),
    "UTM: (5e5, 4.5e6, 100) further": ("1.0", UTM, "0, 0, 0"),
    "geocentric: (4e6, 6e5, 5e6) further": ("1.0", "4e6, 6e5, 5e6", "0, 0, 0"),
    "a thousandth as large": ("0.001", "0, 0, 0", "0, 0, 0"),
    "a thousand times as large": ("1000.0", "0, 0, 0", "0, 0, 0"),
    "a millionth as large": ("1e-6", "0, 0, 0", "0, 0, 0"),
    "a million times as large": ("1e6", "0, 0, 0", "0, 0, 0"),
    "a hundred times as large, at UTM": ("100.0", UTM, "0, 0, 0"),
    "turned": ("1.0", "0, 0, 0", "0.3, -1.1, 0.7"),
}
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
    return {world: [partial(_scores, folder / "work", *WORLDS[world])] for world in WORLDS}


def _scores(folder: Path, scale: str, shift: str, turn: str) -> list[str]:
    """What a training comes to there, and how far its mesh lies from that of the scene at the origin."""
    whole(folder, "mesh")
    for name in ("moved", "moved_run"):
        shutil.rmtree(folder / name, ignore_errors=True)
    for name in ("images", "sparse"):
        shutil.copytree(folder / "scene" / name, folder / "moved" / name)
    _python(folder, MOVED, scale, shift, turn, "moved")
    moved = {"scene": "moved", "run": "moved_run"}
    for name, out in (("train", "moved_run"), ("mesh", "moved.ply")):
        arguments = tuple(moved.get(argument, argument) for argument in COMMANDS[name].arguments)
        code, told = finished(begun(folder, COMMANDS[name]._replace(arguments=arguments), out))
        assert code == 0, told[-2000:]
    manifest = json.loads((folder / "moved_run/manifest.json").read_text())
    apart = float(_python(folder, APART, scale, shift, turn, "mesh.ply", "moved.ply"))
    return [f"{manifest['psnr']:.2f}", f"{manifest['ssim']:.3f}", f"{apart:.4f}"]


def _python(folder: Path, program: str, *arguments: str) -> str:
    asked = [sys.executable, "-c", program, *arguments]
    return subprocess.run(asked, cwd=folder, env=environment(folder), check=True, capture_output=True, text=True).stdout
