"""One strict session for all tests: CPU, no silent promotion of dtypes or ranks.

With GSJAX_TEST_GPU=1 jax chooses the platform, and the tests marked `device` run alone: backends, hard cases, golden.
"""

import gc
import os
import tempfile
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

if os.environ.get("GSJAX_TEST_GPU") != "1":
    os.environ["JAX_PLATFORMS"] = "cpu"
# Tests compile much and run little: XLA's older emitters, and LLVM without its optimisations, take a third of the time
# for the first and are slower at the second. Programs in one piece take two thirds of the memory mappings, which run
# out (below). `XLA_FLAGS= make test` tests the programs that users run. An XLA that does not know a flag ends the
# process, so only where it was seen to.
if os.environ.get("GSJAX_TEST_GPU") == "1":  # Some tests compare bits: sums by atomics come in any order.
    os.environ.setdefault("XLA_FLAGS", "--xla_gpu_deterministic_ops=true")
elif version("jaxlib").startswith("0.10."):
    quick = "cpu_use_fusion_emitters=false", "backend_optimization_level=0", "llvm_disable_expensive_passes=true"
    whole = "cpu_parallel_codegen_split_count=1"
    os.environ.setdefault("XLA_FLAGS", " ".join(f"--xla_{flag}" for flag in (*quick, whole)))

import jax
import pytest
from hard_cases_page import HardCases

jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
ON_DEVICE = os.environ.get("GSJAX_TEST_GPU") == "1"


def pytest_addoption(parser):
    parser.addoption("--quick", action="store_true", help="leave out the files that compile much")
    parser.addoption("--long", action="store_true", help="the tests marked `long` as well")
    parser.addoption("--hard-cases", metavar="FILE", help="write the errors measured on the hard cases as a page")


ERRORS = HardCases()


@pytest.fixture(scope="session")
def hard_cases():
    """Notes what a hard case measured: `hard_cases(case, backend, value=, gradient=, bounds=)`."""
    return ERRORS


STORE = pytest.StashKey[tempfile.TemporaryDirectory]()


def pytest_configure(config):
    """One store of compiled programs and built-in scenes for all workers of this session."""
    if "GSJAX_TEST_SCENES" not in os.environ:  # Set by now in the workers, which inherit it.
        config.stash[STORE] = tempfile.TemporaryDirectory(prefix="gsjax-tests-")
        os.environ["GSJAX_TEST_SCENES"] = config.stash[STORE].name
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        programs = f"{os.environ['GSJAX_TEST_SCENES']}/programs"
        store = {"compilation_cache_dir": programs, "persistent_cache_min_compile_time_secs": 0.1}
        for name, value in store.items():
            jax.config.update(f"jax_{name}", value)
            os.environ[f"JAX_{name.upper()}"] = str(value)


def pytest_collection_finish():
    """Fewer collections of garbage, and none of what was imported: they took a twentieth of the time.

    With fewer still (200,000), functions that nobody holds crowd programs out of jax's own cache.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 10, 10)


def pytest_unconfigure(config):
    if STORE in config.stash:
        config.stash[STORE].cleanup()


def pytest_sessionfinish(session):
    target = session.config.getoption("--hard-cases")
    if target and ERRORS.rows:
        Path(target).write_text(ERRORS.page())


LONGEST = Path(__file__).with_name("longest.txt").read_text().split()
"""Files that took more than 4 seconds, the longest first; nearly all of it is compilation."""
FIRST = 6  # of them, begin a session; the others keep to the files whose programs they share


def pytest_collection_modifyitems(config, items):
    """The longest few files first: at the end no worker waits for the other. Without the long ones, where asked for."""
    folder = Path(__file__).parent
    turns = {folder / f"{name}.py": turn for turn, name in enumerate(LONGEST)}
    items.sort(key=lambda item: min(turns.get(item.path, FIRST), FIRST))
    if ON_DEVICE:
        _keep(config, items, lambda item: item.get_closest_marker("device") and _runs_on_device(item))
    if config.getoption("--quick"):
        _keep(config, items, lambda item: item.path not in turns)
    if not config.getoption("--long"):
        _keep(config, items, lambda item: item.get_closest_marker("long") is None)


def _keep(config, items, is_kept):
    config.hook.pytest_deselected(items=[item for item in items if not is_kept(item)])
    items[:] = [item for item in items if is_kept(item)]


def _runs_on_device(item):
    """The native loops are the CPU's."""
    return jax.default_backend() == "cpu" or "native" not in getattr(item, "callspec", SimpleNamespace(id="")).id


SHARED = Path(__file__).resolve().parents[1] / "../shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of data sets and golden files beside the checkout; skips where there is none."""
    if not SHARED.is_dir():
        pytest.skip("needs the data sets in ../shared, which is not beside this checkout")
    return SHARED.resolve()


@pytest.fixture(scope="module", autouse=True)
def _room_for_programs():
    """Forgets after every file what nobody holds, whose programs take the room of others in jax's own cache.

    And all programs before the system refuses more memory mappings. What a file leaves behind is not searched again:
    searching all of it after every file took a tenth of the session.
    """
    from gsjax.runs.compilations import is_crowded, make_room

    yield
    gc.collect()
    if is_crowded():
        gc.unfreeze()
        make_room()
    gc.freeze()


@pytest.fixture
def x64():
    """Float64 for the length of one test."""
    with jax.enable_x64(True):
        yield
