"""Writes the reference below the tables of docs/api.md: every public name of the rasterizer and of gsjax."""

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.pages import Page

import gsjax
import rasterizer

PAGE = "api.md"


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, **_) -> str:
    """The page with its reference, in the form that mkdocstrings fills."""
    del config
    return f"{markdown}\n{reference()}" if page.file.src_uri == PAGE else markdown


def reference() -> str:
    """A heading for each package, and below it its public names."""
    of_rasterizer = [f"::: rasterizer.{name}" for name in rasterizer.__all__]
    of_gsjax = [f"::: gsjax.{home}.{name}" for name, home in gsjax.HOMES.items()]
    return "\n\n".join(["## Reference: gsjax", *of_gsjax, "## Reference: rasterizer", *of_rasterizer]) + "\n"
