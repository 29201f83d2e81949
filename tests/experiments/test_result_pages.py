"""Pages have the tables of the newest results."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("script", "page"), [("accuracy_vs_time", "accuracy_vs_time.md"), ("effect_detection", "effects.md")]
)
def test_a_page_has_the_table_of_the_results(scripts, script, page):
    rows = json.loads((ROOT / f"experiments/results/{script}.json").read_text())["rows"]
    assert scripts(script).page_table(rows) in (ROOT / "docs" / page).read_text()
