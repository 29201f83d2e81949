import math
import subprocess
import sys

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


def test_a_package_leaves_the_end_that_was_asked_for_to_us():
    """pycolmap's log takes SIGTERM for itself; in a process of its own, for it does so once."""
    program = """
import signal, sys
signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))
from gsjax.io.packages import require
require("pycolmap", "pip install pycolmap")
signal.raise_signal(signal.SIGTERM)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (7, "")
