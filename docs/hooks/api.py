"""Writes the reference below the tables of docs/api.md: every public name of the rasterizer, every module of gsjax.

So a module that is added, moved or removed is added, moved or removed there.
"""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.pages import Page

import rasterizer

ROOT = Path(__file__).resolve().parents[2]
PAGE = "api.md"


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, **_) -> str:
    """The page with its reference, in the form that mkdocstrings fills."""
    del config
    return f"{markdown}\n{reference()}" if page.file.src_uri == PAGE else markdown


def reference() -> str:
    """A heading for each package, and below it what it holds."""
    parts = ["## Reference: rasterizer", *(f"::: rasterizer.{name}" for name in rasterizer.__all__)]
    for package in packages():
        parts += [f"## Reference: {package}", f"::: {package}", *(f"::: {module}" for module in modules(package))]
    return "\n\n".join(parts) + "\n"


def packages() -> list[str]:
    """The names of all packages, but for the commands: `gsjax --help` documents these."""
    folders = (path.parent for path in (ROOT / "gsjax").rglob("__init__.py"))
    names = sorted(".".join(folder.relative_to(ROOT).parts) for folder in folders)
    return [name for name in names if name != "gsjax.cli"]


def modules(package: str) -> list[str]:
    """The dotted names of a package's public modules."""
    files = ROOT.joinpath(*package.split(".")).glob("*.py")
    return sorted(f"{package}.{path.stem}" for path in files if not path.stem.startswith("_"))
