"""What the hard cases measure is a page of results, which is read again, and which a page of the site summarizes."""

import json
from pathlib import Path

from hard_cases_page import comparison, comparison_faults, read_rows, summary

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "experiments/results"


def test_the_page_of_the_site_has_the_summary_of_the_results():
    page = (ROOT / "docs/hard_cases.md").read_text()
    rows = read_rows((RESULTS / "hard_cases.md").read_text())
    assert rows
    assert not [line for line in summary(rows) if line not in page]


def test_both_pages_have_the_comparison_with_gsplat_that_was_measured():
    families = json.loads((RESULTS / "hard_cases_gsplat.json").read_text())["families"]
    page, results = (ROOT / "docs/hard_cases.md").read_text(), (RESULTS / "hard_cases_gsplat.md").read_text()
    assert "\n".join(comparison(families)) in page
    assert "\n".join([*comparison(families), ""]) in results
    assert "\n".join([*comparison_faults(families), ""]) in results


def test_the_comparison_has_every_case_that_renders_colours():
    from hard_scenes import images_by_family

    families = json.loads((RESULTS / "hard_cases_gsplat.json").read_text())["families"]
    assert {family: [*cases] for family, cases in families.items()} == {
        family: [*cases] for family, cases in images_by_family().items()
    }
