"""Whether what gsjax needs is installed and fits, and what to type where it does not.

Only the standard library is imported here, so that a broken installation can be inspected too.
"""

import importlib.util
import itertools
import operator
import os
import re
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from gsjax.io.machine import free_memory
from gsjax.io.packages import EXTRAS, import_uninterrupted, remedy

MODULES = {"pillow": "PIL", "pillow-heif": "pillow_heif", "opencv-contrib-python-headless": "cv2"}
"""Of packages that are not imported by their own names."""
LEAST_MEMORY, LEAST_DISK = 3, 2  # GiB, below which a usual scene does not train, and a run has no room
GIB = 2**30
COMPARISONS = {">=": operator.ge, "<=": operator.le, "==": operator.eq, "!=": operator.ne, "<": operator.lt,
               ">": operator.gt}  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """The result of one check."""

    name: str
    is_fine: bool
    result: str
    remedy: str = ""  # what to type where it is not fine


def examine() -> Iterator[Finding]:
    """Check libraries, the device, the rasterizer's engine, memory, this folder's disk, the cache of programs."""
    broken = set()
    for finding in check_libraries():
        broken |= set() if finding.is_fine else {finding.name}
        yield finding
    if not broken & {"jax", "numpy"}:
        yield from check_device()
    yield check_memory()
    yield check_disk(Path())
    yield check_cache()


def version() -> str:
    """Of gsjax, as it was installed; of a checkout, `pyproject.toml`'s."""
    project = _project()
    return metadata.version("gsjax") if project is None else str(project["version"])


def requirements() -> list[str]:
    """What the core needs, with bounds of versions; then what the extras of `gsjax.io.packages` need."""
    project, extras = _project(), dict.fromkeys(EXTRAS.values())
    if project is None:
        listed = metadata.requires("gsjax") or []
        markers = ["", *(f"extra == '{extra}'" for extra in extras)]
        parts = [line.replace('"', "'").replace(" ;", ";").split("; ") for line in listed]
        lines = [line for line, *marker in parts if "".join(marker) in markers]
    else:
        optional = project["optional-dependencies"]
        lines = [*project["dependencies"], *(line for extra in extras for line in optional[extra])]
    return list(dict.fromkeys(line.replace(" ", "") for line in lines))


def check_libraries() -> Iterator[Finding]:
    """Python, and each library: is it there, does it fit, does it load. Those of extras may be absent."""
    python = ".".join(map(str, sys.version_info[:3]))
    yield Finding("python", sys.version_info >= (3, 11), python, "install Python 3.11 or newer")
    for line in requirements():
        name = re.split("[<>=!]", line)[0]
        yield _check_library(name, line.removeprefix(name))


def _check_library(name: str, bounds: str) -> Finding:
    module, install = MODULES.get(name, name), f"pip install '{name}{bounds}'"
    try:
        installed = metadata.version(name)
    except metadata.PackageNotFoundError:
        extra = EXTRAS.get(module)
        absent = "is not installed" + (f"; the extra {extra} has it" if extra else "")
        return Finding(name, extra is not None, absent, install)
    if not _fits(installed, bounds):
        return Finding(name, False, f"{installed} does not fit {bounds}", install)
    try:
        import_uninterrupted(module)
    except Exception as error:  # Whatever a broken library raises while it loads.
        cause = (str(error).splitlines() or [type(error).__name__])[0]
        return Finding(name, False, f"{installed} does not load: {cause}", remedy(module, error, install))
    return Finding(name, True, installed)


def _fits(version: str, bounds: str) -> bool:
    """Whether a version is within bounds such as `>=0.10.2,!=0.11.1,<0.13`."""
    comparisons = re.findall(r"(>=|<=|==|!=|<|>)([\d.]+)", bounds)
    return all(COMPARISONS[sign](_release(version), _release(bound)) for sign, bound in comparisons)


def _release(version: str) -> tuple[int, ...]:
    """The numbers of a version, up to the first part that holds more."""
    parts = itertools.takewhile(str.isdecimal, version.split("."))
    return tuple(map(int, parts))


def check_device() -> Iterator[Finding]:
    """What jax computes on, and with which engine the rasterizer draws there."""
    from gsjax.rendering.engine import engine_here

    try:
        engine = engine_here()
    except RuntimeError as error:
        yield Finding("device", False, str(error).splitlines()[0], "unset JAX_PLATFORMS")
        return
    unused = gpu_name() if engine.is_on_cpu and os.environ.get("JAX_PLATFORMS") != "cpu" else None
    result = engine.device if unused is None else f"{engine.device}, and {unused} is not used"
    yield Finding("device", unused is None, result, "pip install 'gsjax[cuda13]', or cuda12 where the driver is older")
    remedy = "pip install --force-reinstall numba" if engine.is_on_cpu else "pip install --upgrade 'jax[cuda13]'"
    yield Finding("engine", not engine.why, f"{engine.name} {engine.why}".strip(), remedy)


def check_memory() -> Finding:
    """Whether there is room for a usual scene."""
    free = free_memory() / GIB
    remedy = "close other programs, or train smaller photos (photos.downscale)"
    return Finding("memory", free >= LEAST_MEMORY, f"{free:.1f} GiB free", remedy)


def check_disk(folder: Path) -> Finding:
    """Whether a folder has room for a run."""
    free = shutil.disk_usage(folder).free / GIB
    result = f"{free:.1f} GiB free in {folder.resolve()}"
    return Finding("disk", free >= LEAST_DISK, result, "cd FOLDER, one on a disk with more room")


def check_cache() -> Finding:
    """Whether compiled programs can be kept."""
    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR", "")
    remedy = "export JAX_COMPILATION_CACHE_DIR=FOLDER, a folder that can be written"
    if not folder:
        return Finding("cache", False, "no folder for compiled programs: each start compiles anew", remedy)
    if not os.access(folder, os.W_OK):
        return Finding("cache", False, f"{folder} cannot be written: each start compiles anew", remedy)
    size = sum(file.stat().st_size for file in Path(folder).iterdir() if file.is_file())
    return Finding("cache", True, f"{size / 2**20:.0f} MiB of compiled programs in {folder}")


def likely_device() -> str:
    """What jax will compute on, judged without loading it: a GPU's name, "an NVIDIA GPU" or "the CPU"."""
    has_cuda = any(map(importlib.util.find_spec, ("jax_cuda13_plugin", "jax_cuda12_plugin")))
    if os.environ.get("JAX_PLATFORMS") == "cpu" or not has_cuda:
        return "the CPU"
    return gpu_name() or "the CPU"


def gpu_name() -> str | None:
    """The NVIDIA GPU that the system shows, whether jax can use it or not; None of none."""
    for file in sorted(Path("/proc/driver/nvidia/gpus").glob("*/information")):
        if model := re.search(r"^Model:(.*)$", file.read_text(errors="replace"), re.MULTILINE):
            return model[1].strip()
    return "an NVIDIA GPU" if Path("/dev/nvidia0").exists() else None


def version_line() -> str:
    """Versions, the device and the engine, without loading jax: `gsjax doctor` checks them."""
    device = likely_device()
    on_cpu = "native" if importlib.util.find_spec("numba") else "xla"
    try:
        jax = metadata.version("jax")
    except metadata.PackageNotFoundError:
        jax = "is missing"
    return f"gsjax {version()}, jax {jax}, {on_cpu if device == 'the CPU' else 'pallas'} rasterizer on {device}"


def _project() -> dict | None:
    """The table of `pyproject.toml` in a checkout, which what was installed of it may lag behind; None elsewhere."""
    import tomllib

    file = Path(__file__).resolve().parents[2] / "pyproject.toml"
    return tomllib.loads(file.read_text(encoding="utf-8"))["project"] if file.is_file() else None
