"""How commands end: with an exit code, and a line where something was wrong."""

import errno
import os
import signal
import tempfile

import pytest

import gsjax
from gsjax import cli
from gsjax.errors import InputError

pytestmark = pytest.mark.usefixtures("own_environment")


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (InputError("scene/images.bin: truncated"), 2, "gsjax: error: scene/images.bin: truncated\n"),
        (KeyboardInterrupt(), 130, "gsjax: interrupted\n"),
    ],
)
def test_what_ends_a_command_early(library, monkeypatch, capsys, error, code, message):
    def fail(*args, **kwargs):
        raise error

    monkeypatch.setattr(gsjax.pipeline, "evaluate", fail)
    assert cli.main(["eval", "run"]) == code
    assert capsys.readouterr().err == message


def test_a_command_that_is_asked_to_end_cleans_up_first(library, monkeypatch, tmp_path):
    before = signal.getsignal(signal.SIGTERM)

    def asked(*args, **kwargs):
        with tempfile.TemporaryDirectory(prefix="half-written-", dir=tmp_path):
            signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(gsjax.pipeline, "evaluate", asked)
    assert cli.main(["eval", "run"]) == 128 + signal.SIGTERM
    assert not list(tmp_path.glob("half-written-*"))
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.parametrize("number", [errno.ENAMETOOLONG, errno.EACCES])
def test_a_name_that_the_system_does_not_take_is_told(library, monkeypatch, capsys, number):
    def fail(*args, **kwargs):
        raise OSError(number, os.strerror(number), "runs/long")

    monkeypatch.setattr(gsjax.pipeline, "evaluate", fail)
    assert cli.main(["eval", "run"]) == 2
    assert capsys.readouterr().err == f"gsjax: error: runs/long: {os.strerror(number)}\n"


@pytest.mark.parametrize(
    "error", [MemoryError(), RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 15575512 bytes.")]
)
def test_memory_that_has_ended_is_told(library, monkeypatch, capsys, error):
    def fail(*args, **kwargs):
        raise error

    monkeypatch.setattr(gsjax.pipeline, "evaluate", fail)
    assert cli.main(["eval", "run"]) == 2
    told = capsys.readouterr().err
    assert told.startswith("gsjax: error: memory has ended") and told.count("\n") == 1


def test_a_folder_that_is_no_more_is_told(library, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(gsjax.pipeline, "evaluate", lambda *args, **kwargs: os.path.abspath("run"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gone").mkdir()
    os.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert cli.main(["eval", "run"]) == 2
    assert capsys.readouterr().err == (
        "gsjax: error: the folder in which this was called is no more; go to another one\n"
    )


def test_a_bug_is_not_dressed_up_as_bad_input(library, monkeypatch):
    monkeypatch.setattr(gsjax.pipeline, "evaluate", lambda *args, **kwargs: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cli.main(["eval", "run"])
