"""`reproduce.py` unstubbed: a tiny scene through training, mesh, texture, refinement and tables, killed on the way."""

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_scenes import built_in

from gsjax.io import json_files
from gsjax.io.images import image_size
from gsjax.meshing import read_mesh, read_textured

PATIENCE = 900  # seconds, on a machine with much else to do
SETTINGS = (
    "background=white",
    "max_gaussians=3000",
    "sh_degree=1",
    "phases.vanilla.steps=80",
    "phases.entropy.steps=10",
    "phases.surface.steps=10",
    "rates.opacities=0.2",  # so that they are a surface after so few steps
    "density.start=20",
    "density.every=20",
    "logging.checkpoint_every=20",
    "logging.evaluate_every=0",
)
REFINEMENT = ("steps=10", "faces=1500", "sh_degree=1")


@pytest.mark.long
def test_a_protocol_that_was_killed_goes_on_to_its_tables(scripts, tmp_path):
    built_in(tmp_path / "data/tandt/truck", num_views=9, size=(48, 40))
    out, script = tmp_path / "out", Path(scripts("reproduce").__file__)
    run = out / "truck/paper_6k_15k_0"
    command = [sys.executable, str(script), "--data", str(tmp_path / "data"), "--out", str(out)]
    command += ["--preset", "paper_6k_15k", "--set", *SETTINGS, "--refine", *REFINEMENT]
    kill_once_there(command, run / "run/checkpoints")
    begun = json_files.read(run / "run/manifest.json")["created"]
    assert not (run / "result.json").exists()

    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    result = json_files.read(run / "result.json")
    assert scripts("paper_run").is_finished(result)
    assert json_files.read(run / "run/manifest.json")["created"] == begun, "it went on"
    table = csv.DictReader((out / "tables.csv").read_text().splitlines())
    rows = {row["method"]: row for row in table if row["over"] == "truck"}
    for kind, name in (("coarse", "Gaussians"), ("refined", "refined")):
        row = rows[f"gsjax paper_6k_15k, {name}"]
        assert float(row["psnr"]) == pytest.approx(result[kind]["psnr"], rel=1e-5) and float(row["psnr"]) > 10
        assert "own smoothed normals" in row["notes"] and row["source"] == "measured"
    textured = read_textured(run / "textured.glb")
    assert textured is not None and textured.mesh.num_faces == read_mesh(run / "run/mesh.ply").num_faces > 100
    assert len({tuple(texel) for texel in textured.texture.reshape(-1, 3)[::50]}) > 20, "it is painted"
    width, height = image_size(run / "sheet.png")
    assert width > height > 300, "two rows of four"


def kill_once_there(command: list[str], folder: Path) -> None:
    """Starts a command and kills it, with what it started, once a folder holds a file."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    until = time.monotonic() + PATIENCE
    while not any(folder.glob("*")):
        assert process.poll() is None and time.monotonic() < until
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
