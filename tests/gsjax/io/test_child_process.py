import io
import os
import signal
import sys
import time
from functools import partial

import pytest
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io import messages
from gsjax.io.child_process import run_in_child

quietly = partial(tqdm, disable=True)


def counted(upto, progress):
    with progress(total=upto, desc="counting", unit="one") as bar:
        for _ in range(upto):
            bar.update(1)
        bar.reset()
        bar.update(upto - 1)
    print("noise on standard output")
    return {"sum": sum(range(upto)), "process": os.getpid()}


def crash(number, progress):
    print("terminate called\n  what():  database is locked\n@ 0x1234", file=sys.stderr, flush=True)
    os.kill(os.getpid(), number)


def fail(error, progress):
    messages.print_once("photo.jpg: is noticed")
    messages.print_once("photo.jpg: is noticed")
    raise error


def sleep(pid_file, progress):
    pid_file.write_text(str(os.getpid()))
    with progress(total=1, desc="sleeping", unit="one") as bar:
        bar.update(1)
        time.sleep(600)


def test_results_come_back_and_bars_are_shown_here():
    bars = []

    def progress(**settings):
        bars.append(tqdm(**settings, file=io.StringIO()))
        return bars[-1]

    result = run_in_child(counted, 5, name="it", progress=progress)
    assert result["sum"] == 10
    assert result["process"] != os.getpid()
    assert [(bar.desc, bar.total, bar.n) for bar in bars] == [("counting", 5, 4)]


@pytest.mark.parametrize("number", [signal.SIGABRT, signal.SIGKILL])
def test_a_crash_is_one_line_with_the_last_words(number):
    expected = rf"^it: the process was ended by {number.name} \(database is locked\)(; was there memory left\?)?$"
    with pytest.raises(InputError, match=expected):
        run_in_child(crash, number, name="it", progress=quietly)


def test_errors_keep_their_kind_and_notices_are_shown_here(capsys):
    with pytest.raises(InputError, match=r"^photo.jpg: not a photo$"):
        run_in_child(fail, InputError("photo.jpg: not a photo"), name="it", progress=quietly)
    assert capsys.readouterr().err == "photo.jpg: is noticed\n"
    with pytest.raises(RuntimeError, match=r"in fail\n(.*\n)*KeyError: 'a bug'"):
        run_in_child(fail, KeyError("a bug"), name="it", progress=quietly)


def test_an_interrupt_here_ends_the_process_there(tmp_path):
    class Interruption(tqdm):
        def update(self, n=1):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_in_child(sleep, tmp_path / "pid", name="it", progress=partial(Interruption, disable=True))
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)
