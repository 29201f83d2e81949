"""Faults change one thing each and are in the source while tests run; every file has tests that are run for it."""

import ast
import json
from math import inf

import pytest

SOURCE = '''
"""What 3 - 2 is said of."""
LIMIT: int = 40

def nearest(x, y, first="a" + "b", far=0.5):
    if x < LIMIT and (not far):
        raise ValueError(f"{x - 1} is under {LIMIT}" + " of all" * 2)
    return x[1:] + max(x, axis=0) * -y
'''
FAULTS = [
    ("number", "40", "(80)"),
    ("number", "0.5", "(1.0)"),
    ("truth", "x < LIMIT and (not far)", "(x < LIMIT or not far)"),
    ("comparison", "x < LIMIT", "(x > LIMIT)"),
    ("sign", "not far", "(far)"),
    ("sign", "x[1:] + max(x, axis=0) * -y", "(x[1:] - max(x, axis=0) * -y)"),
    ("dropped", "x[1:] + max(x, axis=0) * -y", "(x[1:])"),
    ("sign", "max(x, axis=0) * -y", "(max(x, axis=0) / -y)"),
    ("dropped", "max(x, axis=0) * -y", "(max(x, axis=0))"),
    ("extreme", "max(x, axis=0)", "(min(x, axis=0))"),
    ("sign", "-y", "(y)"),
]


@pytest.fixture
def checkout(scripts, monkeypatch, tmp_path):
    """A checkout of one file, and a copy of it whose tests notice a limit that is no longer 40."""
    mutations = scripts("mutations")
    monkeypatch.setattr(mutations, "ROOT", tmp_path / "root")
    for place in ("root", "copy"):
        (tmp_path / place).mkdir()
        (tmp_path / place / "source.py").write_text(SOURCE)
    (tmp_path / "root/tests").mkdir()
    (tmp_path / "root/tests/test_source.py").touch()
    monkeypatch.setattr(mutations, "nearest", lambda file: ("tests/test_source.py",))
    ran = []

    def run_tests(folder, tests, limit):
        text = (folder / "source.py").read_text()
        ran.append((text == SOURCE, *tests))
        failed = "tests/test_source.py::test_limit" if "(80)" in text else ""
        return mutations.Outcome(bool(failed), failed, 0.1)

    monkeypatch.setattr(mutations, "run_tests", run_tests)
    return mutations, tmp_path, ran


def test_a_fault_changes_one_expression_and_neither_messages_nor_indices(scripts, tmp_path):
    faults = scripts("faults")
    (tmp_path / "source.py").write_text(SOURCE)
    found = faults.faults_of(tmp_path, "source.py")
    assert [fault[3:] for fault in found] == FAULTS
    for fault in found:
        planted = faults.planted(tmp_path, fault).decode()
        assert planted.replace(fault.after, fault.before, 1) == SOURCE and ast.parse(planted)
    (tmp_path / "source.py").write_text(SOURCE.replace("40", "41"))
    with pytest.raises(ValueError, match=r"source.py has changed: there is no 40 in line 3"):
        faults.planted(tmp_path, found[0])


def test_a_fault_is_there_while_tests_run_and_the_journal_goes_on(checkout):
    mutations, folder, ran = checkout
    faults = mutations.sample(["source.py"], 60, seed=0)
    assert sorted(fault[3:] for fault in faults) == sorted(FAULTS)
    assert mutations.sample(["source.py"], 4, seed=0) == faults[:4]
    file, copy = folder / "journal.jsonl", folder / "copy"
    mutations.try_all(faults, mutations.Journal(file), copy, -inf, 9)
    assert not ran and not file.exists()
    mutations.try_all(faults, mutations.Journal(file), copy, inf, 9)
    unharmed = [tests for is_unharmed, *tests in ran if is_unharmed]
    assert unharmed == [["tests/test_source.py::test_limit"]], "what failed is run without the fault"
    assert len(ran) == len(faults) + 1 and (copy / "source.py").read_text() == SOURCE
    table = mutations.table(faults, mutations.Journal(file))
    assert "| all | 11 | 1 (9%) | 1 (9%) |" in table and "- source.py:6: not far -> (far) (sign)" in table
    missed = next(fault for fault in faults if fault.before == "not far")
    file.write_text(file.read_text() + json.dumps([missed, mutations.Outcome(True, "tests/test_new.py", 1.0)]) + "\n")
    assert "| all | 11 | 1 (9%) | 2 (18%) |" in mutations.table(faults, mutations.Journal(file))


def test_a_test_that_fails_without_a_fault_tells_nothing(checkout, monkeypatch):
    mutations, folder, _ = checkout
    broken = mutations.Outcome(True, "tests/test_source.py::test_limit", 0.1)
    monkeypatch.setattr(mutations, "run_tests", lambda *_: broken)
    with pytest.raises(SystemExit, match="test_limit fails without any fault too"):
        mutations.try_all(
            mutations.sample(["source.py"], 1, 0), mutations.Journal(folder / "j"), folder / "copy", inf, 9
        )


def test_every_file_of_the_rooms_has_tests_that_are_there(scripts):
    mutations = scripts("mutations")
    for room in mutations.ROOMS:
        for path in (mutations.ROOT / room).rglob("*.py"):
            tests = mutations.nearest(str(path.relative_to(mutations.ROOT)))
            assert tests or path.name == "__init__.py", path
            assert all((mutations.ROOT / test).is_file() for test in tests), path
