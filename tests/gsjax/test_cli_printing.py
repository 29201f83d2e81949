"""What a command prints into a pipe that was closed, or onto a full disk, ends it without a traceback."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PRINTING = "import sys; from gsjax.cli import run_guarded; sys.exit(run_guarded(lambda: print('a line ' * LENGTH)))"


def ended(stdout, length):
    asked = [sys.executable, "-c", PRINTING.replace("LENGTH", str(length))]
    done = subprocess.run(asked, stdout=stdout, stderr=subprocess.PIPE, text=True)
    return done.returncode, done.stderr


@pytest.mark.parametrize("length", [1, 100_000])  # written at the end, and before
def test_a_pipe_that_was_closed_ends_a_command_as_it_ends_others(length):
    reader, writer = os.pipe()
    os.close(reader)
    assert ended(writer, length) == (141, "")
    os.close(writer)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux's full device")
@pytest.mark.parametrize("length", [1, 100_000])
def test_a_full_disk_under_what_is_printed_is_told(length):
    with open("/dev/full", "w") as full:
        told = "gsjax: error: what is printed cannot be written: No space left on device\n"
        assert ended(full, length) == (2, told)


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_streams_that_are_closed_take_no_files_number(tmp_path, closed):
    program = "import os, sys; from gsjax.cli import run_guarded\n"
    program += (
        "def work():\n    with open(sys.argv[1], 'w') as file:\n        print('a line')\n        os.write(1, b'x')\n"
    )
    program += "        file.write(str(file.fileno() > 2))\nsys.exit(run_guarded(work))"
    asked = ["sh", "-c", f'exec "$0" "$@" {closed}', sys.executable, "-c", program, str(tmp_path / "file")]
    done = subprocess.run(asked, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "file").read_text() == "True"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux's full device")
def test_an_error_that_nobody_can_read_keeps_its_code():
    program = "import sys; from gsjax import cli; sys.exit(cli.main(['convert', 'absent.ply', 'x.spz']))"
    with open("/dev/full", "w") as full:
        assert subprocess.run([sys.executable, "-c", program], stderr=full).returncode == 2
