"""What is left out of bad photos, frames and points, and when too few remain."""

import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.io.bad_items import Fault, leave_out, leave_out_rows, read_usable


def faults(count):
    return [Fault(f"{index}.png", f"{index}.png: is bad") for index in range(count)]


def test_readable_items_come_back_and_the_others_with_their_reasons():
    def read(number):
        if number % 2:
            raise InputError(f"{number} is odd")
        return 10 * number

    usable, bad = read_usable(range(5), str, read)
    assert usable == [0, 20, 40] and bad == [Fault("1", "1 is odd"), Fault("3", "3 is odd")]
    with pytest.raises(ZeroDivisionError):
        read_usable([0], str, lambda number: 1 / number)


@pytest.mark.parametrize(
    ("count", "total", "line"),
    [
        (1, 3, "0.png: is bad; 1 of 3 photos is left out"),
        (3, 6, "0.png: is bad; 3 of 6 photos are left out: 0.png, 1.png, 2.png"),
        (7, 14, "0.png: is bad; 7 of 14 photos are left out: 0.png, 1.png, 2.png, 3.png, 4.png and 2 more"),
    ],
)
def test_half_may_be_left_out_in_one_line(capsys, count, total, line):
    leave_out("photos", faults(count), total)
    assert capsys.readouterr().err == f"{line}\n"


@pytest.mark.parametrize(("count", "total", "needed"), [(1, 2, 2), (2, 3, 2), (4, 7, 4), (13, 24, 12)])
def test_where_less_than_half_or_than_two_would_remain_all_are_refused(capsys, count, total, needed):
    with pytest.raises(InputError, match=f"^0.png: is bad; {count} of {total} photos cannot be used, and {needed} are"):
        leave_out("photos", faults(count), total)
    assert capsys.readouterr().err == ""


def test_nothing_bad_is_no_line_and_what_is_not_needed_is_never_refused(capsys):
    leave_out("photos", [], 0)
    assert capsys.readouterr().err == ""
    leave_out("photos for testing", faults(2), 2, needed=0)
    assert "2 of 2 photos for testing are left out" in capsys.readouterr().err


def test_rows_are_counted(capsys):
    leave_out_rows("a.ply", "points", np.array([True, False, True, False]))
    assert capsys.readouterr().err == "a.ply: holds values that are not finite; 2 of 4 points are left out\n"
    with pytest.raises(InputError, match="a.ply: holds values that are not finite; 3 of 4 points cannot be used"):
        leave_out_rows("a.ply", "points", np.array([True, False, False, False]))


def test_a_name_of_several_lines_is_one_line(capsys):
    leave_out("photos", [Fault("a\nb", "a\nb: is bad")], 9)
    assert capsys.readouterr().err.count("\n") == 1
