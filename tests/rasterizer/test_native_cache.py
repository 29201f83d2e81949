"""Compiled loops are found by their content, not by where their source lies."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import rasterizer
from rasterizer._native import compiled


def test_a_copy_of_the_package_elsewhere_compiles_nothing(tmp_path):
    shutil.copytree(Path(rasterizer.__file__).parent, tmp_path / "rasterizer")
    before = {file: file.stat().st_mtime_ns for file in compiled.FOLDER.iterdir()}
    program = "import rasterizer._native; print(rasterizer.__file__)"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert Path(done.stdout.strip()).is_relative_to(tmp_path)
    assert done.stderr == ""
    assert before and {file: file.stat().st_mtime_ns for file in compiled.FOLDER.iterdir()} == before
