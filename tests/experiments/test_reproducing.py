"""Every script tells how it is called before anything heavy is imported, and has its row in docs/reproducing.md."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXPERIMENTS = ROOT / "experiments"
SCRIPTS = sorted(
    path.relative_to(ROOT).as_posix() for path in EXPERIMENTS.rglob("*.py") if "__main__" in path.read_text()
)
# In one process: what is not heavy is imported once.
USAGES = """
import contextlib, io, json, runpy, sys
HEAVY = {"jax", "jaxlib", "scipy", "cv2", "numba", "matplotlib", "trimesh", "open3d", "torch", "viser", "optax"}

class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in HEAVY:
            raise AssertionError(f"imports {name} first")

sys.meta_path.insert(0, Nothing())
usages, before = {}, list(sys.path)
for script in json.loads(sys.argv[1]):
    said = io.StringIO()
    sys.path[:], sys.argv = [script.rpartition("/")[0], *before], [script, "--help"]
    try:
        with contextlib.redirect_stdout(said):
            runpy.run_path(script, run_name="__main__")
        usages[script] = "went on"
    except SystemExit as stop:
        usages[script] = said.getvalue() if not stop.code else f"exit code {stop.code}"
    except AssertionError as fault:
        usages[script] = str(fault)
    for name, module in list(sys.modules.items()):
        if "/experiments/" in str(getattr(module, "__file__", None)):
            del sys.modules[name]
print(json.dumps(usages))
"""


@pytest.fixture(scope="module")
def usages():
    """What every script says when it is asked for its usage."""
    scripts = [str(ROOT / script) for script in SCRIPTS]
    asked = [sys.executable, "-c", USAGES, json.dumps(scripts)]
    done = subprocess.run(asked, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return {Path(script).relative_to(ROOT).as_posix(): said for script, said in json.loads(done.stdout).items()}


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_tells_its_question_and_how_it_is_called(usages, script):
    said = usages[script]
    assert said.startswith(f"usage: {Path(script).name}"), said
    assert "?" in said, "the question that it answers"
    assert f"    python {script}" in said


def test_every_study_script_and_picture_has_its_command():
    text = (ROOT / "docs/reproducing.md").read_text()
    named = set(re.findall(r"`python\s(experiments/[\w/]+\.py)", text))
    assert named == set(SCRIPTS)
    studies = {file.stem for file in (EXPERIMENTS / "studies").glob("*.py")}
    assert studies == set(re.findall(r"`COMPARE (\w+)", text))
    assert {"methods", "length"} == set(re.findall(r"`REMESH (\w+)", text))
    assert not [file.name for file in (ROOT / "docs/assets").iterdir() if file.name not in text]


PAGES = [ROOT / "README.md", EXPERIMENTS / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_commands_of_a_page_are_those_of_today(page):
    assert not gone(page.read_text())


@pytest.mark.parametrize("page", sorted((EXPERIMENTS / "results").glob("*.md")), ids=lambda page: page.stem)
def test_a_page_of_results_whose_command_is_gone_tells_the_one_of_today(page):
    """Its command is that of its commit."""
    text = page.read_text()
    assert not gone("\n".join(re.findall(r"^\| Command.*$", text, re.MULTILINE))) or "| Command today |" in text


def gone(text: str) -> set[str]:
    """The scripts and studies that a text calls and that there are not."""
    scripts = {
        script for script in re.findall(r"python (experiments/[\w/]+\.py)", text) if not (ROOT / script).is_file()
    }
    called = re.findall(r"(?:compare|sweep|step_cost|remesh)\.py ([a-z]\w*)", text)
    missing = {script for script in scripts if not (ROOT / script).is_file()}
    return missing | (set(called) - {"methods", "length"} - {f.stem for f in (EXPERIMENTS / "studies").glob("*.py")})


def test_what_is_gone_is_found():
    assert gone("`python experiments/handled.py RUN`, `compare.py growth --scene A`, `remesh.py rates RUN`") == {
        "experiments/handled.py",
        "rates",
    }
