"""What the hard cases measure is a page of results, which is read again, and which a page of the site summarizes."""

import json
from pathlib import Path

from hard_cases_page import HardCases, comparison, comparison_faults, read_rows, summary

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "experiments/results"


def test_a_family_has_its_largest_errors_and_passes_where_each_is_below_its_bound():
    """Of the page that is made of one case whose bounds are not the same for all backends."""
    measured = HardCases()
    measured("forty copies of one", "native", value=2e-6, gradient=4e-5, bounds=(1e-5, 1e-4))
    measured("forty copies of one", "xla", value=1e-6, gradient=3e-3, bounds=(1e-5, 5e-3))

    def stacked():
        (line,) = [line for line in summary(read_rows(measured.page())) if line.startswith("| coincident")]
        return line.partition(" 3,000 | ")[2]

    assert stacked() == " | 2e-06, 4e-05 | 1e-06, 3e-03 |  | 1e-05, 1e-04; xla 1e-05, 5e-03 | pass |"
    measured("all depths coincide", "native", value=2e-6, gradient=2e-4, bounds=(1e-5, 1e-4))
    assert stacked() == " | 2e-06, 2e-04 | 1e-06, 3e-03 |  | 1e-05, 1e-04; xla 1e-05, 5e-03 | fail |"


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
