import re
import subprocess
import sys

import pytest

from gsjax.io.packages import MissingPackageError, require


@pytest.mark.parametrize(
    ("fault", "command"),
    [
        ("raise ModuleNotFoundError('no such module')", r"pip install 'gsjax\[mesh\]'"),
        ("raise ImportError('libusb-1.0.so.0: cannot open\\nmore')", "sudo apt-get install libusb-1.0-0 libgl1"),
        ("raise OSError('libusb-1.0.so.0: cannot open')", "sudo apt-get install libusb-1.0-0 libgl1"),
    ],
)
def test_what_is_missing_is_one_line_with_the_command_that_installs_it(tmp_path, monkeypatch, fault, command):
    (tmp_path / "open3d.py").write_text(fault)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    with pytest.raises(MissingPackageError) as error:
        require("open3d")
    assert re.fullmatch(rf"cannot load open3d \(.*\); install it with: {command}.*", str(error.value))


def test_sigterm_keeps_the_handler_of_the_program():
    """pycolmap's log takes SIGTERM for itself; in a process of its own, for it does so once."""
    program = """
import signal, sys
signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))
from gsjax.io.packages import require
require("pycolmap")
signal.raise_signal(signal.SIGTERM)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (7, "")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_waits_until_a_package_is_loaded(tmp_path, name):
    """A compiled module would turn the exception of the handler into an ImportError, as this one does."""
    (tmp_path / "open3d.py").write_text(f"""
import signal
try:
    signal.raise_signal(signal.{name})
    loaded = True
except BaseException:
    raise ImportError("initialization failed") from None
""")
    program = f"""
import signal, sys
sys.path.insert(0, {str(tmp_path)!r})
from gsjax.cli.stopping import Stopping
from gsjax.io.packages import require
with Stopping() as stopping:
    try:
        require("open3d")
    except BaseException as stop:
        print(type(stop).__name__, sys.modules["open3d"].loaded, stopping.signal.name)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    raised = {"SIGINT": "KeyboardInterrupt", "SIGTERM": "SystemExit"}[name]
    assert (ended.stdout.strip(), ended.stderr) == (f"{raised} True {name}", "")
