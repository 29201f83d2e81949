"""The commands of gsjax on scenes of a few photos: what each reads, what it writes, and what of that is compared."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
Rows = Mapping[str, Sequence[Callable[[], list[str]]]]
"""By what is tried: measurements, each of which gives a cell or more of the row."""

STEPS = "model.max_gaussians=600", "model.sh_degree=0", "logging.checkpoint_every=10", "logging.metrics_every=5"
SMALL = ("--preset", "quick", "--set", "schedule.phases.0.steps=40", *STEPS)
HALF = ("--box", "-9", "-9", "-9", "9", "9", "0")
SPOTS = ("000.png", "20", "24", "000.png", "44", "24")
ANEW, RESUME, NEVER = "anew", "resume", "never"
"""How a command that was stopped is called again: as before, with `--resume`, or not at all (a server)."""

DEMO = """
import sys
from gsjax import config
from gsjax.cli import run_guarded
from gsjax.cli.stopping import leave
from gsjax.pipeline import demo
demo.NUM_VIEWS, demo.SIZE = 9, (32, 32)
short = {"phases": [{"name": "short", "steps": 20}]}
demo.DEMO = config.merge(demo.DEMO, {"model": {"max_gaussians": 600}, "schedule": short, "density": {}})
leave(run_guarded(lambda: demo.run(sys.argv[-1]) and None))
"""


class Command(NamedTuple):
    """One that is tried."""

    arguments: tuple[str, ...]  # all but the last, which names the output
    out: str  # a file or a folder
    products: tuple[str, ...] = (
        "",
    )  # globs within `out`; "" is `out` itself, and ".png" the same name with this suffix
    needs: tuple[str, ...] = ()  # commands whose outputs it reads
    again: str = ANEW
    copy_of: str = ""  # what `out` is before: the command changes what is there
    program: tuple[str, ...] = ("-m", "gsjax")


COMMANDS = {
    "sfm": Command(("sfm", "photos", "--out"), "placed", ("images/*", "sparse/0/*")),
    "train": Command(
        ("train", "scene", *SMALL, "--effects", "none", "--out"), "run", ("gaussians.ply", "cameras.json"), again=RESUME
    ),
    "mesh": Command(("mesh", "run", "--points", "4000", "--depth", "6", "--out"), "mesh.ply", needs=("train",)),
    "refine": Command(
        ("refine", "run", "--mesh", "true.ply", "--steps", "40", "--faces", "800", "--out"),
        "refined",
        ("gaussians.ply", "mesh.ply", "mesh.glb"),
        ("train",),
        RESUME,
    ),
    "texture": Command(("texture", "run", "--mesh", "mesh.ply", "--out"), "textured.glb", needs=("train", "mesh")),
    "scan": Command(
        ("scan", "scene", *SMALL, "effects.names=none", "--out"),
        "scan",
        ("run/gaussians.ply", "run/mesh.ply", "refined/mesh.ply", "mesh.glb", "overview.png"),
    ),
    "eval": Command(("eval", "run", "--json"), "eval.json", needs=("train",)),
    "render": Command(("render", "run", "--out"), "pictures", ("*",), ("train",)),
    "render to MP4": Command(("render", "run", "--turntable", "--seconds", "1", "--out"), "film.mp4", needs=("train",)),
    "share": Command(("share", "run", "--out"), "page.html", needs=("train",)),
    "report": Command(("report",), "reported", ("report.html",), ("train",), copy_of="run"),
    "compare": Command(("compare", "run", "refined", "--out"), "compared.html", needs=("train", "refine")),
    "clean": Command(("clean", "run", *HALF, "--out"), "half.ply", needs=("train",)),
    "clean in place": Command(
        ("clean", *HALF), "cleaned", ("gaussians.ply", "gaussians.ply.*"), ("train",), copy_of="run"
    ),
    "scale": Command(
        ("scale", "--between", *SPOTS, "--is", "1.25m"),
        "scaled",
        ("gaussians.ply", "cameras.json", "place.json", "mesh.ply"),
        ("train", "mesh"),
        copy_of="run",
    ),
    "render to GIF": Command(
        ("render", "mesh.ply", "--turntable", "--seconds", "0.4", "--out"), "turns.gif", needs=("mesh",)
    ),
    "convert": Command(("convert", "run"), "gaussians.spz", needs=("train",)),
    "undistort": Command(("undistort", "scene", "--out"), "pinhole", ("images/*", "sparse/0/*", "hold_out.txt")),
    "normals": Command(
        ("normals", "scene", "--network", "net.json", "--weights", "net.onnx", "--out"), "maps", ("*.npz",)
    ),
    "masks": Command(
        ("masks", "photos", "--network", "kinds.json", "--weights", "net.onnx", "--classes", "red", "--out"),
        "masks",
        ("*.png",),
    ),
    "diagnose": Command(("diagnose", "scene", "--json"), "diagnosis.json", (".png",)),  # The table has times.
    "demo": Command(("demo",), "demo", ("*/gaussians.ply", "*/mesh.ply", "comparison.png"), program=("-c", DEMO)),
    "view": Command(("view", "--port", "0"), "viewed", (), ("train",), NEVER, copy_of="run"),
}
COMPILING = 8
"""Seconds: of a call that takes longer, compilation may be a part, and a second one takes the time without."""
MATERIAL = """
import json
from pathlib import Path
import cv2
import numpy as np
from onnx import TensorProto, helper, save
from gsjax.io import analytic_scene

analytic_scene.write_built_in_scene("scene", num_views=8, size=(64, 48))
Path("scene/gt_mesh.ply").rename("true.ply")  # So few steps lead to no surface that could be scored, or refined.
for file in Path("scene").glob("gt_*"):
    file.unlink()
about = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ("b", 3, "h", "w")) for name in ("photo", "normal")]
graph = helper.make_graph([helper.make_node("Identity", ["photo"], ["normal"])], "colours", about[:1], about[1:])
save(helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)]), "net.onnx")
record = {"licence": "none", "size": {"rule": "multiple"}, "normals": {"place": 0}, "axes": "opengl", "range": "unit"}
Path("net.json").write_text(json.dumps(record))
kinds = {"licence": "none", "size": {"rule": "multiple"}, "output": {"place": 0}, "kind": "scores"}
Path("kinds.json").write_text(json.dumps({**kinds, "classes": ["background", "red", "blue"]}))
rng = np.random.default_rng(0)
noise = lambda height, width: rng.integers(0, 256, (height, width, 3)).astype(np.uint8)
def painted():
    coarse = cv2.resize(noise(150, 200), (800, 600), interpolation=cv2.INTER_CUBIC)
    return cv2.addWeighted(coarse, 0.7, cv2.GaussianBlur(noise(600, 800), (0, 0), 1.5), 0.6, 0)
far, near = painted(), painted()
Path("photos").mkdir()
for index in range(6):  # A wall, and before it three squares, which move twice as fast.
    x, y = 15 * (index % 3), 15 * (index // 3)
    photo = far[100 + y : 340 + y, 100 + x : 420 + x].copy()
    for top, left in (60, 60), (150, 40), (90, 200):
        photo[top - y : top - y + 70, left - x : left - x + 70] = near[top : top + 70, left : left + 70]
    cv2.imwrite(f"photos/{index}.png", photo)
Path("whole").touch()
"""


def environment(folder: Path) -> dict[str, str]:
    """That of every call: this checkout, and programs that are compiled once."""
    return {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(folder / "cache"), "COLUMNS": "200"}


def start_command(
    folder: Path, command: Command, out: str, *more: str, before: tuple[str, ...] = ()
) -> subprocess.Popen:
    """Start the command in a folder with what it reads; Ctrl-C reaches it even where the shell disabled that."""
    return subprocess.Popen(
        [*before, sys.executable, *command.program, *command.arguments, out, *more],
        cwd=folder,
        env=environment(folder),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    )


def finished(process: subprocess.Popen) -> tuple[int, str]:
    """Exit code and stderr, without the steps of progress bars."""
    stderr = process.communicate()[1]
    return process.returncode, "\n".join(line.rpartition("\r")[2] for line in stderr.split("\n"))


def products(folder: Path, command: Command, out: str) -> dict[str, bytes]:
    """The bytes of what is compared, by name."""
    place = folder / out
    one = {"": place, ".png": place.with_suffix(".png")}
    files = [file for name in command.products for file in ([one[name]] if name in one else sorted(place.glob(name)))]
    assert files or not command.products, f"{place} has none of {command.products}"
    return {file.relative_to(place.parent).as_posix(): file.read_bytes() for file in files}


def whole(folder: Path, name: str) -> float:
    """Leaves in a folder what an undisturbed call of a command writes, and what it reads.

    Returns:
        How long the call takes once its programs are compiled, seconds.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "whole").exists():
        subprocess.run([sys.executable, "-c", MATERIAL], cwd=folder, env=environment(folder), check=True)
    command, file = COMMANDS[name], folder / "seconds.json"
    for need in command.needs:
        whole(folder, need)
    seconds = json.loads(file.read_text()) if file.exists() else {}
    if name not in seconds and command.again != NEVER:
        seconds[name] = _called(folder, name, command.out)
        if seconds[name] > COMPILING:
            seconds[name] = _called(folder, name, f"again/{command.out}")
            assert products(folder, command, f"again/{command.out}") == products(folder, command, command.out), name
        file.write_text(json.dumps(seconds))
    return seconds.get(name, 10.0)


def _called(folder: Path, name: str, out: str) -> float:
    """Calls a command, which has to end well; seconds."""
    if (folder / out).is_dir():  # Of a call that this one was stopped in.
        shutil.rmtree(folder / out)
    prepare(folder, COMMANDS[name], out)
    began = time.monotonic()
    code, stderr = finished(start_command(folder, COMMANDS[name], out))
    assert code == 0, f"{name} ended with {code}: {stderr[-2000:]}"
    return time.monotonic() - began


def prepare(folder: Path, command: Command, out: str) -> None:
    """Makes the folder that the output is to be in, and what the command changes."""
    (folder / out).parent.mkdir(exist_ok=True)
    if command.copy_of:
        shutil.copytree(folder / command.copy_of, folder / out)


def leftovers(folder: Path) -> list[Path]:
    """What is not whole, of writers that are no more."""
    return [path for path in folder.rglob(".*.gsjax-*") if "cache" not in path.relative_to(folder).parts]
