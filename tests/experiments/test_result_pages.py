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


def test_times_are_of_one_machine():
    """The table has the times of seed 0, the first row of every preset and scene."""
    rows = json.loads((ROOT / "experiments/results/accuracy_vs_time.json").read_text())["rows"]
    assert len({row["cpu"] for row in rows if row["seed"] == 0}) == 1
    kinds = [(row["scene"], row["preset"], row["vanilla"]) for row in rows]
    assert all(rows[kinds.index(kind)]["seed"] == 0 for kind in kinds)
