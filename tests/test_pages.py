"""The pages keep their word: commands parse, settings exist, code runs as it stands, names are those of the source."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_scenes import few_samples

from gsjax import cli, config
from gsjax.binding.bound import bind, to_mesh
from gsjax.binding.hybrid import Hybrid, all_gaussians
from gsjax.binding.refining import Refinement
from gsjax.io.ply import write_gaussians
from gsjax.mesh import Mesh
from gsjax.meshing import write_mesh
from gsjax.settings import PRESETS, Settings

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BESIDE = [ROOT / "CONTRIBUTING.md", ROOT / "experiments/README.md"]  # no part of the site, held to the same
PYTHON = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES + BESIDE, ids=named)
def test_every_command_line_parses(page):
    text = page.read_text().replace("\\\n", " ")
    commands = re.findall(r"^ {4}(?:\.venv/bin/)?gsjax (.*)$", text, re.MULTILINE)
    for command in commands:
        assert cli.parser().parse_args(shlex.split(command, comments=True)).run


@pytest.mark.parametrize("page", PAGES + BESIDE, ids=named)
def test_every_setting_exists_and_takes_the_value(page):
    kind, preset = (Refinement, {}) if page.name == "refinement.md" else (Settings, PRESETS["fast"])
    whole = config.to_dict(config.parse(kind, preset))
    for assignment in re.findall(r"--set (\w+(?:\.\w+)*=(?![A-Z]+\b)[\w.]+)", page.read_text()):
        config.parse(kind, config.override(whole, [assignment]))


@pytest.mark.parametrize("page", [page for page in PAGES if PYTHON.search(page.read_text())], ids=named)
def test_code_runs_as_it_stands(page, readers_folder, monkeypatch):
    """The blocks of a page share their names, and find the files that the page's commands would have written."""
    monkeypatch.chdir(readers_folder)
    text, names = page.read_text(), {"__name__": "__main__"}
    for block in PYTHON.finditer(text):
        above = text.count("\n", 0, block.start(1))  # Tracebacks then name the page's own line.
        with few_samples():
            exec(compile("\n" * above + block[1], str(page), "exec"), names)


@pytest.fixture
def readers_folder(tmp_path) -> Path:
    """Where a reader is after the commands of the pages: a mesh of the run, and a refined one with its Gaussians."""
    ball = trimesh.creation.icosphere(2)
    mesh = Mesh(np.float32(ball.vertices), np.int32(ball.faces), np.full((len(ball.vertices), 3), 128, np.uint8))
    bound = bind(mesh, per_triangle=1, thickness=0.004, sh_degree=1, opacity=0.8)
    refined = tmp_path / "runs/refined"
    refined.mkdir(parents=True)
    write_mesh(tmp_path / "garden.ply", mesh)
    write_mesh(refined / "mesh.ply", to_mesh(bound))
    write_gaussians(refined / "gaussians.ply", all_gaussians(Hybrid(bound)))
    return tmp_path
