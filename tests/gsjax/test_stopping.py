"""A signal ends a command after it has cleaned up, and the process without tearing libraries down."""

import signal
import subprocess
import sys
import tempfile

import pytest

from gsjax.cli import environment, run_guarded


@pytest.mark.parametrize(
    ("number", "code", "line"),
    [(signal.SIGINT, 130, "gsjax: interrupted\n"), (signal.SIGTERM, 143, "gsjax: terminated\n")],
)
def test_a_signal_cleans_up_and_gives_its_exit_code(monkeypatch, tmp_path, capsys, number, code, line):
    """Also where a library has turned the exception into its own."""
    monkeypatch.setattr(environment, "prepare", lambda: None)
    before = signal.signal(number, signal.SIG_DFL)
    try:

        def work():
            with tempfile.TemporaryDirectory(dir=tmp_path):
                try:
                    signal.raise_signal(number)
                except BaseException:
                    raise RuntimeError("INTERNAL: a callback failed") from None

        assert run_guarded(work) == code
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, before)
    assert capsys.readouterr().err == line
    assert not list(tmp_path.iterdir())


PROCESS = """
import atexit, sys, threading, time
from gsjax.cli.stopping import leave, skip_teardown

class Library:
    def __del__(self):
        print("torn down", flush=True)

skip_teardown()
atexit.register(print, "exit function")
library = Library()
threading.Thread(target=lambda: time.sleep(0.5) or print("thread", flush=True)).start()
leave(int(sys.argv[1]))
"""


@pytest.mark.parametrize(("code", "output"), [(3, "thread\nexit function\n"), (130, ""), (143, "")])
def test_a_process_waits_for_threads_unless_a_signal_ends_it_and_tears_nothing_down(code, output):
    done = subprocess.run([sys.executable, "-c", PROCESS, str(code)], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (code, output, "")
