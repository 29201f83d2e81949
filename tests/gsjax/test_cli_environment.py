"""What the command line settles before jax is loaded: vectors, the cache of programs, and how fast help answers."""

import inspect
import logging
import os
import subprocess
import sys
import time
import warnings

import pytest

from gsjax import cli
from gsjax.cli import environment

COMMANDS = (
    "demo", "scan", "sfm", "normals", "train", "mesh", "refine", "texture", "eval", "render", "report", "compare",
    "turntable", "view", "undistort", "convert",
)  # fmt: skip

pytestmark = pytest.mark.usefixtures("own_environment")


@pytest.mark.parametrize(
    ("flags", "cpu", "expected"),
    [
        (None, {"avx512f"}, "--xla_cpu_prefer_vector_width=512"),
        ("--xla_a=1", {"avx512f"}, "--xla_a=1 --xla_cpu_prefer_vector_width=512"),
        ("--xla_cpu_prefer_vector_width=256", {"avx512f"}, "--xla_cpu_prefer_vector_width=256"),
        (None, {"avx2"}, None),
    ],
)
def test_wide_vectors_where_the_cpu_has_them_and_the_user_has_no_say(monkeypatch, flags, cpu, expected):
    if flags is not None:
        monkeypatch.setenv("XLA_FLAGS", flags)
    monkeypatch.setattr(environment, "cpu_flags", lambda: cpu)
    environment.prepare()
    assert os.environ.get("XLA_FLAGS") == expected


@pytest.mark.parametrize("flags", ["", "--xla_gpu_autotune_level=4"])
def test_for_a_gpu_no_loop_is_compiled_twice_unless_the_user_says_so(monkeypatch, flags):
    monkeypatch.setenv("XLA_FLAGS", flags)
    monkeypatch.setattr(environment, "cpu_flags", set)
    monkeypatch.setattr(environment, "find_spec", lambda name: name == "jax_cuda13_plugin" or None)
    environment.prepare()
    assert os.environ["XLA_FLAGS"] == (flags or "--xla_gpu_autotune_level=0")


def test_the_compilation_cache_is_the_users_or_their_choice(monkeypatch, tmp_path):
    environment.prepare()
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == str(tmp_path / "cache/gsjax/xla")
    assert (tmp_path / "cache/gsjax/xla").is_dir()
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "elsewhere")
    environment.prepare()
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == "elsewhere"


def test_a_gpus_memory_is_taken_as_it_is_used_unless_the_user_says_otherwise(monkeypatch):
    monkeypatch.delenv("XLA_PYTHON_CLIENT_PREALLOCATE", raising=False)
    environment.prepare()
    assert os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] == "false"
    monkeypatch.setenv("XLA_PYTHON_CLIENT_PREALLOCATE", "true")
    environment.prepare()
    assert os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] == "true"


def test_windows_itself_is_refused_in_one_line():
    """Its Python has no modules of these names."""
    program = (
        "import sys; sys.modules |= {'resource': None, 'fcntl': None}\n"
        "import gsjax.cli; sys.platform = 'win32'; sys.exit(gsjax.cli.main(['train', 'scene', '--out', 'run']))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    line = "gsjax: error: Windows itself is not supported; gsjax runs there in WSL2: https://aka.ms/wsl"
    assert (done.returncode, done.stderr.splitlines()) == (2, [line])


def test_a_damaged_program_of_the_cache_is_taken_out_and_nobody_is_warned(monkeypatch, tmp_path):
    """It is named as jax names its files and in jax's words, which the next test holds against jax."""
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    shown = []
    monkeypatch.setattr(warnings, "showwarning", lambda message, *_, **__: shown.append(str(message)))
    kept, gone = ("jit_step-2-0af3-cache", "jit_stepper-0af3-cache"), ("jit_step-0af3-cache", "jit_step-77-atime")
    for name in (*kept, *gone):
        (tmp_path / name).write_bytes(b"x")
    environment.replace_damaged_programs()
    environment.replace_damaged_programs()
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        environment.replace_damaged_programs()  # `catch_warnings` has put the usual function back.
        for name in ("jit_step", "jit_other"):
            warnings.warn(
                f"Error reading persistent compilation cache entry for '{name}': XlaRuntimeError: x", stacklevel=1
            )
        warnings.warn("something else", stacklevel=1)
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(kept)
    assert shown == ["something else"]


def test_a_plugin_of_jax_that_does_not_load_is_one_line(caplog):
    logger = logging.getLogger("jax._src.xla_bridge")
    environment.prepare()
    try:
        raise RuntimeError("Unable to load cuPTI. Is it installed?") from OSError("error 999")
    except RuntimeError:
        logger.exception(
            f"{environment.PLUGIN_FAULT}: Exception when calling %s.initialize()", "jax_plugins.xla_cuda13"
        )
    logger.warning(f"{environment.PLUGIN_FAULT}: Plugin module %s does not exist", "a.b")
    logger.error("another %s", "matter")
    told = "gsjax: jax goes on without a plugin that does not load here"
    assert [logging.Formatter().format(record) for record in caplog.records] == [
        f"{told}: Unable to load cuPTI. Is it installed?",
        f"{told}: {environment.PLUGIN_FAULT}: Plugin module a.b does not exist",
        "another matter",
    ]


def test_jax_speaks_and_names_its_files_as_is_expected():
    from jax._src import compiler, lru_cache, xla_bridge

    assert f'logger.exception("{environment.PLUGIN_FAULT}: Exception' in inspect.getsource(xla_bridge)
    assert "Error reading persistent compilation cache entry for \"\n        f\"'{module_name}': " in inspect.getsource(
        compiler._cache_read
    )
    assert (lru_cache._CACHE_SUFFIX, lru_cache._ATIME_SUFFIX) == ("-cache", "-atime")


def test_no_room_for_the_cache_is_harmless(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    environment.prepare()
    assert "JAX_COMPILATION_CACHE_DIR" not in os.environ


def test_help_answers_at_once_and_without_jax():
    show = "import sys, gsjax.cli; code = gsjax.cli.main(['--help']); sys.exit(code or 'jax' in sys.modules)"
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", show], capture_output=True, text=True)
    seconds = time.perf_counter() - start
    assert done.returncode == 0, done.stderr
    assert all(command in done.stdout for command in COMMANDS)
    assert seconds < 2  # 0.05 s alone; a loaded machine gets time, an import of jax or open3d does not pass above.


def test_python_dash_m_is_the_same_command():
    done = subprocess.run([sys.executable, "-m", "gsjax", "train"], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("gsjax train: error: the following arguments are required")


@pytest.mark.parametrize("flags", ["", "--xla_gpu_deterministic_ops=false", "--xla_gpu_deterministic_ops=true"])
def test_a_training_asks_xla_for_the_same_bits_in_every_run(monkeypatch, tmp_path, flags):
    monkeypatch.setenv("XLA_FLAGS", f"--xla_a=1 {flags}".strip())
    assert cli.main(["train", str(tmp_path), "--out", str(tmp_path / "run"), "--deterministic"]) == 2  # no data set
    assert os.environ["XLA_FLAGS"].split()[-1] == "--xla_gpu_deterministic_ops=true"
    assert os.environ["XLA_FLAGS"].count("deterministic") == 1
