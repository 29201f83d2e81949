"""The kinds of damage that `experiments/breaking` tries are tests."""


def test_what_is_damaged_are_tests_that_there_are(scripts):
    damage = scripts("breaking.damage")
    for tests in damage.KINDS.values():
        file, _, test = tests.partition(" ")[0].partition("::")
        assert f"def {test or 'test_fuzz'}" in (damage.ROOT / file).read_text(), tests
