"""A measured figure on a page stands in the results that its section cites."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "experiments/results"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?(?:e-?\d+)?")
FIGURE = re.compile(r"(?<![\w.,/:])(\d[\d,]*\.\d+)(?![\d.e])( (?:dB|degrees|deg|GiB|cm)\b)?")
UNCITED = {  # section: what its figures are
    "## Whole scenes and runs": "bounds that tests assert",
    "## Faults and results": "printed by the command of the page",
}
CELL = re.compile(r"[-+ ]*(?:\d[\d,]*+(?:\.\d+)?[-+, ;/]*(?:dB|deg|to)?[ -]*)+")  # of nothing but figures


def sections(page: Path) -> list[str]:
    """Of text alone: no code, no addresses of links."""
    text = re.sub(r"^```[\s\S]*?^```$|^ {4}.*$", "", page.read_text(), flags=re.M)
    return re.split(r"^(?=#+ )", text, flags=re.M)


def figures(section: str) -> list[str]:
    """Decimals with a unit, and those of cells that hold figures alone."""
    lines = re.sub(r"`[^`]*`|\]\([^)]*\)|\*\*", "", section).splitlines()
    tables = [cell for line in lines if line.startswith("|") for cell in line.split("|") if CELL.fullmatch(cell)]
    prose = [number for line in lines for number, unit in FIGURE.findall(line) if unit]
    return list(dict.fromkeys(prose + [number for cell in tables for number, _ in FIGURE.findall(cell)]))


def cited(section: str) -> list[Path]:
    names = re.findall(r"([a-z_0-9]+\.(?:md|json))[`)]", section)
    return [RESULTS / name for name in dict.fromkeys(names) if (RESULTS / name).is_file()]


def is_among(figure: str, numbers: list[float]) -> bool:
    """Whether a number is the figure when it is rounded to as many digits."""
    half = 0.5 * 10.0 ** -len(figure.partition(".")[2])
    return any(abs(number - float(figure.replace(",", ""))) <= 1.001 * half for number in numbers)


def unsupported(section: str) -> list[str]:
    """Figures that no file has which the section cites."""
    numbers = [float(n.replace(",", "")) for file in cited(section) for n in NUMBER.findall(file.read_text())]
    return [figure for figure in figures(section) if not is_among(figure, numbers)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_figure_is_in_the_results_that_its_section_cites(page):
    missing = {}
    for section in sections(page):
        heading, is_measured = section.partition("\n")[0], bool(cited(section)) or " dB" in section
        if is_measured and heading not in UNCITED and unsupported(section):
            missing[heading] = unsupported(section)
    assert not missing


def test_a_figure_that_no_result_has_is_noticed():
    """In prose, in a cell and without a citation; a page whose figures are right has many of them."""
    source = "(`experiments/results/lambda_r.md`)"
    assert unsupported(f"From 36.91 to 36.59 dB {source}.") == ["36.59"]
    assert unsupported(f"| 0.2 | 36.58 | 13.4 deg |\n{source}") == ["13.4"]
    assert unsupported("It has 36.91 dB.") == ["36.91"]
    assert sum(len(figures(section)) for page in PAGES for section in sections(page)) > 300
