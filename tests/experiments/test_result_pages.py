"""Pages have the tables of the newest results."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TABLES = {  # result file: the script that prints its table, and the page that has it
    "accuracy_vs_time": ("accuracy_vs_time", "accuracy_vs_time.md"),
    "effect_detection": ("effect_detection", "effects.md"),
    "ablation": ("compare", "comparisons.md"),
}


@pytest.mark.parametrize("results", TABLES)
def test_a_page_has_the_table_of_the_results(scripts, results):
    script, page = TABLES[results]
    record = json.loads((ROOT / f"experiments/results/{results}.json").read_text())
    table = scripts(script).page_table(record["rows"])
    assert record["table"] == table.splitlines()
    assert table in (ROOT / "docs" / page).read_text()
