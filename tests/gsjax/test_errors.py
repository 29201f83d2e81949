"""A message is one line, whatever stands in the files that it speaks of."""

from gsjax.errors import InputError


def test_a_message_is_one_line_that_prints():
    name = "a\nb\t\x1b[2J\0\udce4"
    assert str(InputError(f"{name}: no such file")) == "a\\nb\\t\\x1b[2J\\x00\\udce4: no such file"
    assert str(InputError("Straße 1, 日本/a b.png: cut")) == "Straße 1, 日本/a b.png: cut"
