"""What was measured is not measured again, whole rows alone are shown, and every part has its columns."""

import pytest


@pytest.fixture
def part(scripts):
    """A part of two rows, which notes what is measured."""
    names = []

    def measurement(name, *cells):
        def measure():
            names.append(name)
            return list(cells)

        return measure

    rows = {"a": [measurement("a0", "1"), measurement("a1", "2")], "b": [measurement("b", "3", "4")]}
    return scripts("breaking").Part("Tried", ("What", "Here", "There"), lambda folder: rows), names


def test_a_part_goes_on_where_it_was_stopped(scripts, part, tmp_path):
    robustness, (part, names) = scripts("robustness"), part
    file = tmp_path / "part.json"
    assert robustness.measured(part, file, tmp_path, only=["nothing"]) == {} and not names
    file.write_text('{"a": [["1"]]}')
    rows = robustness.measured(part, file, tmp_path)
    assert (rows, names) == ({"a": ["1", "2"], "b": ["3", "4"]}, ["a1", "b"])
    assert robustness.measured(part, file, tmp_path) == rows and len(names) == 2
    assert robustness.table(part, rows) == (
        "## Tried\n\n| What | Here | There |\n| --- | --- | --- |\n| a | 1 | 2 |\n| b | 3 | 4 |\n"
    )


def test_what_is_damaged_are_tests_that_there_are(scripts):
    damage = scripts("breaking.damage")
    for tests in damage.KINDS.values():
        file, _, test = tests.partition(" ")[0].partition("::")
        assert f"def {test or 'test_fuzz'}" in (damage.ROOT / file).read_text(), tests
