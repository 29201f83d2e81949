"""Result files in JSON: rows with the version of the product, the machine, and the versions of packages."""

import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from gsjax.io import json_files

ROOT = Path(__file__).parents[1]
RESULTS, PICTURES = ROOT / "experiments/results", ROOT / "docs/assets"

Row = dict[str, Any]


def read(name: str) -> list[Row]:
    """The rows of `results/NAME.json` that today's product made; none where it changed."""
    before = json_files.read(file) if (file := RESULTS / f"{name}.json").exists() else {}
    return before["rows"] if before.get("version") == _about()["version"] else []


def write(name: str, rows: Sequence[Row], table: str) -> None:
    """Write the rows, and the table that a page has of them, as `results/NAME.json`."""
    json_files.write(RESULTS / f"{name}.json", {**_about(), "table": table.splitlines(), "rows": rows})


@cache
def _about() -> dict[str, Any]:
    """The product's content, whatever the pages say, the machine and the packages."""
    from gsjax.io.machine import machine, versions

    trees = subprocess.run(
        ["git", "rev-parse", "HEAD:gsjax", "HEAD:rasterizer"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    version = "+".join(each[:8] for each in trees.stdout.split())
    return {"version": version, "machine": machine(), "versions": versions()}
