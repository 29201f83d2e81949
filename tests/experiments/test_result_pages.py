"""Pages have the tables of the newest results."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def rows_of(script):
    return json.loads((ROOT / f"experiments/results/{script}.json").read_text())["rows"]


@pytest.mark.parametrize(
    ("script", "page"), [("accuracy_vs_time", "accuracy_vs_time.md"), ("effect_detection", "effects.md")]
)
def test_a_page_has_the_table_of_the_results(scripts, script, page):
    assert scripts(script).page_table(rows_of(script)) in (ROOT / "docs" / page).read_text()


def test_the_table_of_the_presets_has_minutes_where_all_rows_have_them(scripts):
    rows = [row | {"minutes": 2.04} for row in rows_of("accuracy_vs_time")]
    head, _, first, *_ = scripts("accuracy_vs_time").page_table(rows).splitlines()
    assert head.startswith("| Scene | Preset | Minutes | Normals |") and "` | 2.0" in first
