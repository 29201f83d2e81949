"""Damaged files, by format and by how much of each is damaged: read, or refused by one line."""

import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

from breaking.commands import ROOT, Rows

TITLE = "Damaged files"
PLACES = (1, 3, 30)
COLUMNS = "Files", *(f"Damaged in {'one place' if most == 1 else f'up to {most} places'}" for most in PLACES)
TIMES = 470  # files of every kind and number of places
KINDS = {
    "Gaussians: PLY, compressed PLY, SPZ; points": "tests/gsjax/io/test_fuzz_gaussians.py",
    "Meshes: PLY, OBJ, GLB, with and without a texture": "tests/gsjax/meshing/files/test_fuzz_meshes.py",
    "`transforms.json`": "tests/gsjax/io/test_damaged_data_sets.py::test_fuzz_transforms",
    "COLMAP models, text and binary": "tests/gsjax/io/test_damaged_data_sets.py::test_fuzz_colmap",
    "Photos and masks of nine formats": "tests/gsjax/io/test_damaged_data_sets.py::test_fuzz_photos_and_masks",
    "Normal maps, arrays: `.npy`, `.npz`, PNG": "tests/gsjax/io/test_damaged_data_sets.py -k maps",
    "True depth and surfaces": "tests/gsjax/io/test_damaged_data_sets.py::test_fuzz_truth",
    "Lists of photos, clouds": "tests/gsjax/io/test_damaged_data_sets.py::test_fuzz_lists_and_clouds",
    "Seven files of a run": "tests/gsjax/runs/test_fuzz_runs.py::test_fuzz_the_files_of_a_run",
    "Checkpoints": "tests/gsjax/runs/test_fuzz_runs.py::test_fuzz_checkpoints",
    "Stereo depth and normals of a run": "tests/gsjax/stereo/test_maps.py::test_fuzz_stereo_maps",
    "Records of networks": "tests/gsjax/runs/test_fuzz_runs.py::test_fuzz_records_of_networks",
    "Other JSON": "tests/gsjax/io/test_json_files.py::test_fuzz_json",
}


def rows(folder: Path) -> Rows:
    """A row a kind of files."""
    return {kind: [partial(_damaged, folder, tests, most) for most in PLACES] for kind, tests in KINDS.items()}


def _damaged(folder: Path, tests: str, most: int) -> list[str]:
    """The readers' own tests of damaged files, so many of each."""
    log = folder / "damage.jsonl"
    log.unlink(missing_ok=True)
    counts = {"GSJAX_FUZZ": str(TIMES), "GSJAX_FUZZ_DAMAGES": str(most), "GSJAX_FUZZ_LOG": str(log)}
    where, _, named = tests.partition(" -k ")
    expression = f"test_fuzz and {named}" if named else "test_fuzz"
    command = [sys.executable, "-m", "pytest", "--numprocesses", "0", "-p", "no:cacheprovider", "-k", expression, where]
    environment = {**os.environ, **counts, "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert log.exists(), done.stdout[-3000:]
    records = [json.loads(line) for line in log.read_text().splitlines()]
    attempts, read, refused = (sum(test[count] for test in records) for count in ("tried", "read", "refused"))
    if read + refused < attempts:
        print(done.stdout[-3000:], file=sys.stderr)
    return [f"{read + refused:,} of {attempts:,}, {read:,} read"]
