"""Runs the notebooks while the site is built, and shows each as a page with its pictures.

A notebook is a Python file of cells (jupytext's percent format) in docs/notebooks. A cell that raises ends the build.
"""

import os
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path

import jupytext
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbconvert import MarkdownExporter
from nbformat import NotebookNode, writes

FOLDER = "notebooks"
PATIENCE = 600  # Seconds that one cell may take.


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds what becomes of every notebook: the page, its pictures, and the notebook itself for those who want it."""
    sources = sorted(Path(config.docs_dir, FOLDER).glob("*.py"))
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # Each runs in a process of its own.
        for contents in pool.map(outcome, sources):
            for name, content in contents.items():
                files.append(File.generated(config, f"{FOLDER}/{name}", content=content))
    return files


def outcome(source: Path) -> dict[str, str | bytes]:
    """What becomes of one notebook, by file names.

    Raises:
        PluginError: A cell raised.
    """
    notebook = jupytext.read(source)
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    plain = writes(notebook)
    page, pictures = as_markdown(executed(notebook, source), source.stem)
    return {f"{source.stem}.ipynb": plain, f"{source.stem}.md": page, **pictures}


def executed(notebook: NotebookNode, source: Path) -> NotebookNode:
    """The notebook with its outputs, run by this very Python in a folder of its own.

    Raises:
        PluginError: A cell raised.
    """
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(notebook, timeout=PATIENCE, resources={"metadata": {"path": folder}})
        try:
            client.execute(env=environment())
        except CellExecutionError as error:
            raise PluginError(f"{source}: {error}") from error
    for cell in notebook.cells:
        if cell.cell_type == "code":  # Progress bars are no part of a page.
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
    return notebook


def environment() -> dict[str, str]:
    """Of the process that runs a notebook: it compiles much and runs little, and is spared XLA's optimisations."""
    spared = {"OPEN3D_DISABLE_WEB_VISUALIZER": "true"}  # It would serve a page.
    if version("jaxlib").startswith("0.10."):  # An unknown flag would end the process (tests/conftest.py).
        spared["XLA_FLAGS"] = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0"
    return spared | os.environ


def as_markdown(notebook: NotebookNode, name: str) -> tuple[str, dict[str, bytes]]:
    """Return the page, with a link to the notebook, and its pictures by their relative paths."""
    text, resources = MarkdownExporter().from_notebook_node(notebook, {"output_files_dir": f"{name}_files"})
    title, rest = text.lstrip().split("\n", 1)
    return f"{title}\n\n[Download as a notebook]({name}.ipynb)\n\n{rest}", resources["outputs"]
