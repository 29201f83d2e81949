import math

import pytest

from gsjax.errors import InputError
from gsjax.io.packages import require


def test_what_is_there_is_imported():
    assert require("math", "") is math


@pytest.mark.parametrize(
    "fault", ["raise ImportError('libusb-1.0.so.0: cannot open\\nmore')", "raise OSError('no GL')"]
)
def test_what_is_missing_is_one_line_with_the_cure(tmp_path, monkeypatch, fault):
    (tmp_path / "halfinstalled.py").write_text(fault)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r"cannot load halfinstalled \(.*\); install it with: apt install it") as error:
        require("halfinstalled", "apt install it")
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match=r"No module named 'not_there'.*pip install not_there"):
        require("not_there", "pip install not_there")
