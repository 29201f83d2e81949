"""What a number was measured on and with: the machine, and the versions of what computed it."""

import os
import platform
import re
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path, PurePosixPath

from gsjax.errors import InputError

_ASKING = threading.Condition()
_PROMISED: list[float] = []  # bytes, to blocks of `memory_for` that go on
PACKAGES = ("gsjax", "jax", "jaxlib", "optax", "numpy", "scipy", "pycolmap", "open3d", "trimesh", "onnxruntime")


def machine() -> dict[str, str | int | None]:
    """CPU model, usable cores, memory, operating system, and the accelerator that jax computes on (None: the CPU)."""
    import jax

    device = jax.local_devices()[0]
    cpu = re.search(r"^model name\s*:\s*(.+)$", _text("/proc/cpuinfo"), re.MULTILINE)
    return {
        "cpu": cpu[1] if cpu else platform.processor() or platform.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30),
        "platform": platform.platform(),
        "accelerator": None if device.platform == "cpu" else device.device_kind,
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that are installed; in a git checkout, the commit of the source."""
    by_package = {"python": platform.python_version()}
    for package in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            by_package[package] = metadata.version(package)
    commit = _commit()
    return by_package | {"commit": commit} if commit else by_package


def peak_memory(path: str | Path = "/proc/self/status") -> int:
    """Most physical memory that this process has held since its program began, bytes.

    On Linux, `ru_maxrss` of a new process would begin with that of the one that started it.
    """
    match = re.search(r"^VmHWM:\s*(\d+) kB$", _text(path), re.MULTILINE)
    if match:
        return 1024 * int(match[1])
    import resource  # Which Windows has not.

    unit = 1 if platform.system() == "Darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def free_memory() -> int:
    """Bytes of memory that this process could still take: by Linux, container and `ulimit`; elsewhere half of all."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    match = re.search(r"^MemAvailable:\s*(\d+) kB$", _text("/proc/meminfo"), re.MULTILINE)
    free = 1024 * int(match[1]) if match else total // 2
    return min([free, *_left_in_groups(), *_left_in_limits()])


def _left_in_groups() -> Iterator[int]:
    """Bytes that each control group around this process may still take; of what one has, cached files can go."""
    own = _text("/proc/self/cgroup")
    second = "/sys/fs/cgroup", r"^0::(/.*)$", "max", "current", "inactive_file"
    first = "/sys/fs/cgroup/memory", r"^\d+:memory:(/.*)$", "limit_in_bytes", "usage_in_bytes", "total_inactive_file"
    for root, line, limit, used, cached in (second, first):
        match = re.search(line, own, re.MULTILINE)
        path = PurePosixPath(match[1] if match else "/")
        for group in (path, *path.parents):
            begin = f"{root}{group}".rstrip("/") + "/memory."
            most, now = (_text(begin + name).strip() for name in (limit, used))
            if most.isdecimal() and now.isdecimal():
                files = re.search(rf"^{cached} (\d+)$", _text(begin + "stat"), re.MULTILINE)
                yield int(most) - int(now) + (int(files[1]) if files else 0)


def _left_in_limits() -> Iterator[int]:
    """Bytes that this process may still take by its own limits, as `ulimit -v` and `ulimit -d` set them."""
    limits, status = _text("/proc/self/limits"), _text("/proc/self/status")
    for limit, used in (("address space", "VmSize"), ("data size", "VmData")):
        most = re.search(rf"^Max {limit} +(\d+) ", limits, re.MULTILINE)
        now = re.search(rf"^{used}:\s+(\d+) kB$", status, re.MULTILINE)
        if most and now:
            yield int(most[1]) - 1024 * int(now[1])


def require_memory(what: str, size: float) -> None:
    """Raises InputError where so many bytes are not free; it begins with `what`: a file or an option, and its need."""
    free = free_memory()
    if size > free:
        raise InputError(f"{what} takes {size / 2**30:.3g} GiB of memory; {max(0, free) / 2**30:.3g} are free")


@contextmanager
def memory_for(what: str, size: float) -> Iterator[None]:
    """As `require_memory`, for the block: other threads that call meanwhile wait until there is room for theirs too."""
    with _ASKING:
        _ASKING.wait_for(lambda: not _PROMISED or size <= free_memory() - sum(_PROMISED))
        require_memory(what, size)
        _PROMISED.append(size)
    try:
        yield
    finally:
        with _ASKING:
            _PROMISED.remove(size)
            _ASKING.notify_all()


def restart_peak_memory() -> None:
    """Makes `peak_memory` begin anew, where the system lets it (Linux)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def cpu_flags(path: str | Path = "/proc/cpuinfo") -> frozenset[str]:
    """Instruction-set flags of the first core as Linux names them (`avx512f`); empty on other systems."""
    match = re.search(r"^flags\s*:(.*)$", _text(path), re.MULTILINE)
    return frozenset(match[1].split()) if match else frozenset()


def _text(path: str | Path) -> str:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _commit() -> str | None:
    """Abbreviated commit of the checkout that this file runs from, with a `+` where the source has changed since."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    describe = ["git", "-C", str(root), "describe", "--always", "--dirty=+", "--exclude=*"]
    try:
        return subprocess.run(describe, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None  # No git, or a checkout of another user's: the versions are without it.
