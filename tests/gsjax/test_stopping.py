"""A signal that asks to end is never lost, wherever in a command it comes."""

import gc
import signal
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from gsjax.cli import environment, run_guarded
from gsjax.cli.stopping import AGAIN, Stopping

SIGNALS = {signal.SIGINT: 130, signal.SIGTERM: 143}


@pytest.fixture(autouse=True)
def own_environment(monkeypatch):
    """Nothing is prepared, and no signal is ignored, as it is in a session that a shell put into the background."""
    monkeypatch.setattr(environment, "prepare", lambda: None)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def go_on(seconds=10 * AGAIN):
    """Work that answers signals."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(0.01)
    raise AssertionError("the signal was lost")


def in_the_garbage_collector(number):
    def callback(phase, info):
        gc.callbacks.remove(callback)
        signal.raise_signal(number)

    gc.callbacks.append(callback)
    gc.collect()
    go_on()


def in_a_finalizer(number):
    class Held:
        def __del__(self):
            signal.raise_signal(number)

    Held()
    go_on()


def where_all_is_caught(number):
    with suppress(BaseException):
        signal.raise_signal(number)
    go_on()


def where_another_is_made_of_it(number):
    try:
        signal.raise_signal(number)
    except BaseException:
        raise RuntimeError("INTERNAL: a callback failed") from None


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize(
    "work", [in_the_garbage_collector, in_a_finalizer, where_all_is_caught, where_another_is_made_of_it]
)
def test_what_loses_the_exception_does_not_lose_the_signal(work, number, capsys):
    assert run_guarded(lambda: work(number)) == SIGNALS[number]
    told = {signal.SIGINT: "gsjax: interrupted\n", signal.SIGTERM: "gsjax: asked to end\n"}
    assert capsys.readouterr().err == told[number]


def test_what_cleans_up_is_left_to_finish_and_is_not_asked_twice():
    cleaned = []

    def work():
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            try:
                raise OSError("within the cleaning")
            except OSError:
                time.sleep(3 * AGAIN)
            signal.raise_signal(signal.SIGINT)
            cleaned.append(True)

    assert run_guarded(work) == 143
    assert cleaned == [True]


def test_what_is_done_when_the_signal_comes_is_done():
    assert run_guarded(lambda: None) == 0
    with Stopping() as stopping:
        pass
    stopping._raise(signal.SIGTERM, None)  # as between the end of the work and the return of the signals
    assert stopping.signal is None


def test_an_alarm_of_others_asks_nothing():
    assert run_guarded(lambda: signal.raise_signal(signal.SIGALRM)) == 0


def test_signals_are_given_back_and_ignored_ones_stay_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        assert run_guarded(lambda: signal.raise_signal(signal.SIGINT)) == 0
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
    handlers = [signal.getsignal(number) for number in (*SIGNALS, signal.SIGALRM)]
    assert run_guarded(lambda: signal.raise_signal(signal.SIGTERM)) == 143
    assert [signal.getsignal(number) for number in (*SIGNALS, signal.SIGALRM)] == handlers
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0)


@pytest.mark.parametrize(("code", "waits"), [(130, False), (143, False), (0, True), (2, True)])
def test_who_was_asked_to_end_waits_for_no_thread(code, waits):
    program = f"""
import threading, time
from gsjax.cli.stopping import leave
threading.Thread(target=lambda: time.sleep(1.5) or print("waited", flush=True)).start()
print("cleaned up")
leave({code})
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == code
    assert done.stdout == "cleaned up\n" + "waited\n" * waits


TEARDOWN = """
import atexit, sys
from gsjax.cli.stopping import leave, spare_the_teardown

class Library:
    def __del__(self):
        sys.stderr.write("torn down")

spare_the_teardown()
atexit.register(print, "farewell")
library = Library()
{how}
"""


@pytest.mark.parametrize(
    ("how", "code", "torn"), [("leave(3)", 3, False), ("leave(0)", 0, False), ("raise ValueError('a fault')", 1, True)]
)
def test_libraries_say_farewell_and_are_not_torn_down(how, code, torn):
    ended = subprocess.run([sys.executable, "-c", TEARDOWN.format(how=how)], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (code, "farewell\n")
    assert ("torn down" in ended.stderr) == torn
