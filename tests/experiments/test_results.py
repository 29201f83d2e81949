"""A page of experiments/results tells how its figures came about, and its links lead somewhere."""

import re
from pathlib import Path

import pytest

PAGES = sorted((Path(__file__).resolve().parents[2] / "experiments/results").glob("*.md"))


@pytest.mark.parametrize("page", [page for page in PAGES if page.name != "README.md"], ids=lambda page: page.stem)
def test_a_study_names_its_command_its_machine_and_its_commit(page):
    text = page.read_text()
    assert re.search(r"^ {4}(python|gsjax|make) |`(python|pytest|gsjax|make) ", text, re.MULTILINE), "no command"
    assert re.search(r"\b(CPU|EPYC|Xeon|H100)\b", text), "no machine"
    assert re.search(r"\b(?=[0-9a-f]*\d)[0-9a-f]{7}\b", text), "no commit"
    assert re.search(r"^\|(---\|)+$", text, re.MULTILINE), "no table"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_of_a_study_lead_to_files(page):
    text = page.read_text()
    targets = re.findall(r"\]\(([^)#\s]+)", text) + re.findall(r"^\[[\w-]+\]: (\S+)$", text, re.MULTILINE)
    assert not [target for target in targets if "://" not in target and not (page.parent / target).exists()]
