"""The pages keep their word: commands parse, settings exist, code runs as it stands, names are those of the source."""

import importlib
import importlib.util
import re
import shlex
import tokenize
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_scenes import built_in

from gsjax import cli, config
from gsjax.binding.bound import bind, to_mesh
from gsjax.binding.mixed_gaussians import MixedGaussians, all_gaussians
from gsjax.binding.refinement import Refinement
from gsjax.io import analytic_scene
from gsjax.io.ply import write_gaussians
from gsjax.meshing.export import write_mesh
from gsjax.presets import PRESETS
from gsjax.scene.meshes import Mesh
from gsjax.settings import Settings

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


WORKFLOW = ROOT / ".github/workflows/checks.yml"


@pytest.mark.parametrize("page", [ROOT / "README.md", BESIDE[0], WORKFLOW, ROOT / ".ci/run"], ids=named)
def test_every_target_of_make_exists(page):
    targets = set(re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)[1].split())
    commands = re.findall(r"(?:^ {4}| run: |\$\(|^)make ([a-z -]+[a-z])", page.read_text(), re.MULTILINE)
    words = {word for line in commands for word in line.split("  ")[0].split() if not word.startswith("-")}
    assert words
    assert words <= targets


def test_the_longest_test_files_exist():
    names = (ROOT / "tests/longest.txt").read_text().split()
    assert not [name for name in names if not (ROOT / f"tests/{name}.py").is_file()]


def test_the_citation_is_of_this_version():
    (version,) = re.findall(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert version == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


@pytest.mark.parametrize("page", PAGES + BESIDE, ids=named)
def test_every_setting_exists_and_takes_the_value(page):
    kind, preset = (Refinement, {}) if page.name == "meshes.md" else (Settings, PRESETS["fast"])
    whole = config.to_dict(config.parse(kind, preset))
    for assignment in re.findall(r"--set (\w+(?:\.\w+)*=(?![A-Z]+\b)[\w.]+)", page.read_text()):
        config.parse(kind, config.override(whole, [assignment]))


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as MkDocs makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower()) for heading in headings}


@pytest.mark.parametrize("page", [*PAGES, *BESIDE, *sorted((ROOT / "experiments/results").glob("*.md"))], ids=named)
def test_every_anchor_is_a_heading(page):
    links = re.findall(r"\]\(([^):#\s]*)#([^)\s]+)\)", page.read_text())
    targets = [((page.parent / name).resolve() if name else page, anchor) for name, anchor in links]
    assert not [(str(t), a) for t, a in targets if t.is_file() and t.suffix == ".md" and a not in anchors(t)]


@pytest.mark.parametrize("page", PAGES + BESIDE, ids=named)
def test_names_and_files_of_the_source_exist(page):
    text = page.read_text()
    assert not absent(text)
    paths = re.findall(r"`((?:gsjax|rasterizer|experiments|tests|docs)/[\w./]*\.\w+)`", text)
    paths += re.findall(r"python (experiments/[\w/]+\.py)", text)
    paths += [f"experiments/studies/{study}.py" for study in re.findall(r"compare\.py ([a-z]\w*)", text)]
    assert not [path for path in paths if not (ROOT / path).exists()]
    in_files = re.findall(r"`(?:\w+\.)*([\w-]+)` in `([\w/]+\.py)`", text)
    assert not [(word, path) for word, path in in_files if word not in (ROOT / path).read_text()]


SOURCES = sorted(path for folder in ("rasterizer", "gsjax") for path in (ROOT / folder).rglob("*.py"))


def test_names_in_docstrings_and_comments_exist():
    faults = {named(path): absent(prose(path)) for path in SOURCES}
    assert not {path: names for path, names in faults.items() if names}


def pages_with_code():
    """Those with Python; the loop of the README is that of `docs/own_loop.md`, and `test_core_install.py` runs it."""
    pages = [page for page in PAGES if PYTHON.search(page.read_text())]
    return [pytest.param(page, marks=[pytest.mark.long] * (page.name == "README.md"), id=named(page)) for page in pages]


@pytest.mark.parametrize("page", pages_with_code())
def test_code_runs_as_it_stands(page, readers_folder, monkeypatch):
    """The blocks of a page share their names, and find the files that the page's commands would have written."""
    monkeypatch.chdir(readers_folder)
    monkeypatch.setattr(analytic_scene, "write_built_in_scene", built_in)  # the same files, made once a session
    text, names = page.read_text(), {"__name__": "__main__"}
    for block in PYTHON.finditer(text):
        above = text.count("\n", 0, block.start(1))  # Tracebacks then name the page's own line.
        exec(compile("\n" * above + block[1], str(page), "exec"), names)


def test_the_tests_that_the_map_of_the_paper_names_exist():
    tests = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", (ROOT / "docs/paper_map.md").read_text())
    assert tests
    for file, name in tests:
        assert (ROOT / file).is_file(), file
        assert f"def {name}" in (ROOT / file).read_text(), f"{file}::{name}"


def test_every_script_study_and_picture_has_its_command():
    text = (ROOT / "experiments/README.md").read_text()
    scripts = {named(file) for file in (ROOT / "experiments").rglob("*.py") if "__main__" in file.read_text()}
    assert set(re.findall(r"`python\s(experiments/[\w/]+\.py)", text)) == scripts
    studies = {file.stem for file in (ROOT / "experiments/studies").glob("*.py")}
    assert set(re.findall(r"compare\.py ([a-z]\w*)", text)) == studies
    assert not [file.name for file in (ROOT / "docs/assets").iterdir() if file.name not in text]


DOTTED = re.compile(r"(?<![\w/.])(?:gsjax|rasterizer)(?:\.[A-Za-z]\w*)+")


def absent(text: str) -> list[str]:
    """The dotted names of modules, and of what they hold, that do not exist; names of files are none."""
    names = {name for name in DOTTED.findall(text) if not name.endswith((".md", ".py"))}
    return sorted(name for name in names if not exists(name))


def exists(name: str) -> bool:
    path, *rest = name.split(".")
    value = importlib.import_module(path)
    for part in rest:
        path = f"{path}.{part}"
        if hasattr(value, "__path__") and importlib.util.find_spec(path):
            value = importlib.import_module(path)
        elif hasattr(value, part):
            value = getattr(value, part)
        else:  # A field without a default is no attribute of its class.
            return part in getattr(value, "__dataclass_fields__", {})
    return True


def prose(path: Path) -> str:
    """Docstrings and comments of a source file: what no import and no checker of types looks at."""
    with path.open("rb") as file:
        kinds = {tokenize.COMMENT, tokenize.STRING}
        return "\n".join(token.string for token in tokenize.tokenize(file.readline) if token.type in kinds)


@pytest.fixture(scope="session")
def garden(tmp_path_factory) -> Path:
    """A small data set with normal maps, for the page that trains on one."""
    return built_in(tmp_path_factory.mktemp("data") / "garden", num_views=9, size=(48, 40))


@pytest.fixture
def readers_folder(tmp_path, garden) -> Path:
    """Where a reader is after the commands of the pages: a mesh of the run, and a refined one with its Gaussians."""
    ball = trimesh.creation.icosphere(2)
    mesh = Mesh(np.float32(ball.vertices), np.int32(ball.faces), np.full((len(ball.vertices), 3), 128, np.uint8))
    bound = bind(mesh, per_triangle=1, thickness=0.004, sh_degree=1, opacity=0.8)
    refined = tmp_path / "runs/refined"
    refined.mkdir(parents=True)
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes/garden").symlink_to(garden)
    write_mesh(tmp_path / "garden.ply", mesh)
    write_mesh(refined / "mesh.ply", to_mesh(bound))
    write_gaussians(refined / "gaussians.ply", all_gaussians(MixedGaussians(bound)))
    return tmp_path
