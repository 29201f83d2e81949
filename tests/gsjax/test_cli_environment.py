"""The environment that commands set up before jax is loaded, and how commands end: exit codes, and one line of why."""

import errno
import os
import signal
import subprocess
import sys
import tempfile

import pytest

import gsjax
from gsjax import cli
from gsjax.cli import environment
from gsjax.errors import InputError

pytestmark = pytest.mark.usefixtures("own_environment")


def test_wide_vectors_where_the_cpu_has_them_and_the_user_has_no_say(monkeypatch):
    wide, narrow = (f"--xla_cpu_prefer_vector_width={bits}" for bits in (512, 256))
    for flags, cpu, expected in (
        ("--xla_a=1", "avx512f", f"--xla_a=1 {wide}"),
        (narrow, "avx512f", narrow),
        ("", "avx2", ""),
    ):
        monkeypatch.setenv("XLA_FLAGS", flags)
        monkeypatch.setattr(environment, "cpu_flags", lambda cpu=cpu: {cpu})
        environment.prepare()
        assert os.environ["XLA_FLAGS"] == expected


def test_the_compilation_cache_is_the_users_or_their_choice(monkeypatch, tmp_path):
    environment.prepare()
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == str(tmp_path / "cache/gsjax/xla")
    assert (tmp_path / "cache/gsjax/xla").is_dir()
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "elsewhere")
    environment.prepare()
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == "elsewhere"


def test_windows_itself_is_refused_in_one_line():
    """Its Python has no modules of these names."""
    program = (
        "import sys; sys.modules |= {'resource': None, 'fcntl': None}\n"
        "import gsjax.cli; sys.platform = 'win32'; sys.exit(gsjax.cli.main(['train', 'scene', '--out', 'run']))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    line = "gsjax: error: Windows itself is not supported; gsjax runs there in WSL2: https://aka.ms/wsl"
    assert (done.returncode, done.stderr.splitlines()) == (2, [line])


def test_help_of_every_command_imports_no_heavy_package():
    show = """
import contextlib, sys
from gsjax import cli
heavy = {*"jax numba open3d scipy cv2 matplotlib trimesh pycolmap viser optax PIL".split()}
for name in ("", *cli.parser()._subparsers._group_actions[0].choices):
    with contextlib.suppress(SystemExit):
        cli.main([*filter(None, [name]), "--help"])
    assert not heavy & {*sys.modules}, name
"""
    done = subprocess.run([sys.executable, "-c", show], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "usage: gsjax train" in done.stdout and "usage: gsjax render" in done.stdout


def test_a_training_asks_xla_for_the_same_bits_in_every_run(library, monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_a=1 --xla_gpu_deterministic_ops=false")
    assert cli.main(["train", "scene", "--out", "run", "--deterministic"]) == 0
    assert os.environ["XLA_FLAGS"].split()[-1] == "--xla_gpu_deterministic_ops=true"
    assert os.environ["XLA_FLAGS"].count("deterministic") == 1


NO_ROOM = "memory has ended; smaller photos (--downscale), fewer Gaussians or fewer other programs leave more"


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (InputError("scene/images.bin: truncated"), 2, "gsjax: error: scene/images.bin: truncated\n"),
        (KeyboardInterrupt(), 130, "gsjax: interrupted\n"),
        (BrokenPipeError(), 141, ""),
        (OSError(errno.ENAMETOOLONG, "File name too long", "r"), 2, "gsjax: error: r: File name too long\n"),
        (MemoryError(), 2, f"gsjax: error: {NO_ROOM}\n"),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 15575512 bytes."), 2, f"gsjax: error: {NO_ROOM}\n"),
        (
            OSError(errno.ENOSPC, "No space left on device"),
            2,
            "gsjax: error: what is printed cannot be written: No space left on device\n",
        ),
    ],
)
def test_what_ends_a_command_is_one_line_and_an_exit_code(library, monkeypatch, capsys, error, code, message):
    def fail(*args, **kwargs):
        raise error

    monkeypatch.setattr(gsjax.pipeline, "evaluate", fail)
    assert cli.main(["eval", "run"]) == code
    assert capsys.readouterr().err == message


def test_a_bug_is_not_dressed_up_as_bad_input(library, monkeypatch):
    monkeypatch.setattr(gsjax.pipeline, "evaluate", lambda *args, **kwargs: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cli.main(["eval", "run"])


def test_sigterm_cleans_up_and_ends_a_command_with_143(monkeypatch, tmp_path, capsys):
    """Also where a library has turned the exception into its own."""
    monkeypatch.setattr(environment, "prepare", lambda: None)

    def work():
        with tempfile.TemporaryDirectory(dir=tmp_path):
            try:
                signal.raise_signal(signal.SIGTERM)
            except BaseException:
                raise RuntimeError("INTERNAL: a callback failed") from None

    before = signal.getsignal(signal.SIGTERM)
    assert cli.run_guarded(work) == 143
    assert signal.getsignal(signal.SIGTERM) is before
    assert capsys.readouterr().err == "gsjax: terminated\n"
    assert not list(tmp_path.iterdir())


PROCESS = """
import atexit, sys
from gsjax.cli.stopping import leave, skip_teardown

class Library:
    def __del__(self):
        print("torn down", flush=True)

skip_teardown()
atexit.register(print, "exit function")
library = Library()
leave(int(sys.argv[1]))
"""


@pytest.mark.parametrize(("code", "output"), [(3, "exit function\n"), (143, "")])
def test_a_process_ends_without_tearing_libraries_down(code, output):
    done = subprocess.run([sys.executable, "-c", PROCESS, str(code)], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (code, output, "")
