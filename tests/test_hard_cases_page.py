"""What the hard cases measure is a page of results, which is read again, and which a page of the site summarizes."""

from pathlib import Path

import pytest
from hard_cases_page import HardCases, read_rows, summary

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def measured():
    """Errors of few cases: one that nothing shows, and one whose bounds are not the same for all backends."""
    cases = HardCases()
    for name in ("behind", "opacity 0"):
        cases(f"hidden: {name}", "xla", value=0, gradient=0, bounds=(0, 0))
    cases("forty copies of one", "native", value=2e-6, gradient=4e-5, bounds=(1e-5, 1e-4))
    cases("forty copies of one", "xla", value=1e-6, gradient=3e-3, bounds=(1e-5, 5e-3))
    return cases


def test_the_page_is_read_again(measured):
    assert read_rows(measured.page()) == {
        "hidden, each of 2": {"xla": ((0, 0), (0, 0))},
        "forty copies of one": {"native": ((2e-6, 4e-5), (1e-5, 1e-4)), "xla": ((1e-6, 3e-3), (1e-5, 5e-3))},
    }


def test_a_family_has_its_largest_errors_and_passes_where_each_is_below_its_bound(measured):
    def stacked():
        (line,) = [line for line in summary(read_rows(measured.page())) if line.startswith("| coincident")]
        return line.partition(" 3,000 | ")[2]

    assert stacked() == "2e-06 | 1e-05 | 3e-03 | 5e-03 | pass |"
    measured("all depths coincide", "native", value=2e-6, gradient=2e-4, bounds=(1e-5, 1e-4))
    assert stacked() == "2e-06 | 1e-05 | 3e-03 | 5e-03 | fail |"


def test_a_case_of_no_family_is_named(measured):
    measured("planes: an unlisted case", "native", value=0, gradient=0, bounds=(1e-5, 1e-4))
    with pytest.raises(AssertionError, match="of no family: \\['an unlisted case'\\]"):
        summary(read_rows(measured.page()))


def test_the_page_of_the_site_has_the_summary_of_the_results():
    page = (ROOT / "docs/hard_cases.md").read_text()
    rows = read_rows((ROOT / "experiments/results/hard_cases.md").read_text())
    assert rows
    assert not [line for line in summary(rows) if line not in page]
