"""Every script tells its question and how it is called, before anything heavy is imported."""

import json
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
