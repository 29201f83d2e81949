"""Notebooks of the docs: what holds becomes a page with its pictures, what does not ends the build."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

for package in ("mkdocs", "jupytext", "nbclient", "nbconvert", "ipykernel"):
    pytest.importorskip(package, reason="make .venv/.installed-docs installs what the notebooks need")

ROOT = Path(__file__).parents[1]
NOTEBOOK = """# %% [markdown]
# # A title
#
# Text with [a link](../index.md).

# %%
import sys
from matplotlib import pyplot
pyplot.plot([1, 2])
pyplot.show()
print(sys.executable)

# %%
print("a " + "bar", file=sys.stderr)
assert 1 + 1 == {sum}
"""


def built(folder, notebook):
    (folder / "docs" / "notebooks").mkdir(parents=True)
    (folder / "docs" / "index.md").write_text("# Home\n")
    (folder / "docs" / "notebooks" / "one.py").write_text(notebook)
    config = {
        "site_name": "s",
        "strict": True,
        "exclude_docs": "*.py",
        "hooks": [str(ROOT / "docs/hooks/notebooks.py")],
    }
    (folder / "mkdocs.yml").write_text(json.dumps(config))
    command = [sys.executable, "-m", "mkdocs", "build", "--strict"]
    return subprocess.run(command, cwd=folder, env={**os.environ, "MPLBACKEND": ""}, capture_output=True, text=True)


def test_a_notebook_that_holds_is_a_page_with_its_pictures_and_is_there_to_download(tmp_path):
    done = built(tmp_path, NOTEBOOK.replace("{sum}", "2"))
    assert done.returncode == 0, done.stderr
    site = tmp_path / "site" / "notebooks"
    page = (site / "one" / "index.html").read_text()
    (picture,) = (site / "one_files").iterdir()
    assert picture.read_bytes().startswith(b"\x89PNG") and f"../one_files/{picture.name}" in page
    assert sys.executable in page, "the kernel is this very Python"
    assert 'href="../one.ipynb"' in page and "a bar" not in page
    cells = json.loads((site / "one.ipynb").read_text())["cells"]
    assert [cell["cell_type"] for cell in cells] == ["markdown", "code", "code"]
    assert not any(cell.get("outputs") for cell in cells)
    assert not list((tmp_path / "site").rglob("*.py"))


def test_an_assertion_that_fails_ends_the_build(tmp_path):
    done = built(tmp_path, NOTEBOOK.replace("{sum}", "3"))
    assert done.returncode != 0 and "AssertionError" in done.stderr
