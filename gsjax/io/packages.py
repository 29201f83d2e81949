"""Packages of the extras, as in `pip install 'gsjax[mesh]'`: loaded on first use, and named in a line if missing."""

import importlib
import importlib.util
import logging
import signal
import sys
import threading
from types import FrameType, ModuleType
from typing import Any

from gsjax.errors import InputError

EXTRAS = {
    "open3d": "mesh",
    "trimesh": "mesh",
    "xatlas": "mesh",
    "cv2": "sfm",
    "pillow_heif": "sfm",
    "pycolmap": "sfm",
    "jinja2": "view",
    "matplotlib": "view",
    "viser": "view",
    "zstandard": "view",
    "onnxruntime": "networks",
}
"""Module -> the extra of `pyproject.toml` that installs it. OpenCV is in other extras too, which need it."""
SYSTEM_LIBRARIES = {"open3d": "libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1 libidn2-0"}
"""Packages of Debian and Ubuntu that a module loads."""


class MissingPackageError(InputError):
    """A package of an extra, or a system library under it, is absent."""


class DeferredModule:
    """A module that is imported when one of its attributes is first read."""

    def __init__(self, module: str):
        """Remember the name."""
        self._module = module

    def __getattr__(self, name: str) -> Any:
        return getattr(require(self._module), name)


def require(module: str) -> ModuleType:
    """Import a package of an extra; where it is absent, MissingPackageError names the extra."""
    try:
        imported = import_uninterrupted(module)
    except (ImportError, OSError) as error:
        cause, command = str(error).splitlines()[0], remedy(module, error, _install(module))
        raise MissingPackageError(f"cannot load {module} ({cause}); install it with: {command}") from error
    if module == "trimesh":  # It would print a traceback for a picture that is absent.
        logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    return imported


def import_uninterrupted(module: str) -> ModuleType:
    """Import a module. SIGINT and SIGTERM wait until it is loaded, where a Python function handles them.

    Within the import of a compiled module, the exception of a handler would become an `ImportError`.
    """
    if module in sys.modules or threading.current_thread() is not threading.main_thread():
        return importlib.import_module(module)
    arrived: list[int] = []

    def wait(number: int, frame: FrameType | None) -> None:
        arrived.append(number)

    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number, handler in handlers.items():
        if callable(handler):
            signal.signal(number, wait)
    try:
        return importlib.import_module(module)
    finally:
        for number, handler in handlers.items():  # Google's log, which pycolmap loads, replaces SIGTERM's below Python.
            if handler is not None:
                signal.signal(number, handler)
        for number in arrived[:1]:
            signal.raise_signal(number)


def check_installed(*modules: str) -> None:
    """Search packages without loading them; where one is absent, MissingPackageError names the extra."""
    for module in modules:
        try:
            is_installed = importlib.util.find_spec(module) is not None
        except ImportError:
            is_installed = False
        if not is_installed:
            raise MissingPackageError(f"{module} is not installed; install it with: {_install(module)}")


def remedy(module: str, error: Exception, install: str) -> str:
    """The command that installs what is absent: `install`, or that of the system libraries of an installed package."""
    is_installed = not isinstance(error, ModuleNotFoundError)
    if is_installed and module in SYSTEM_LIBRARIES:
        return f"sudo apt-get install {SYSTEM_LIBRARIES[module]}"
    return install


def _install(module: str) -> str:
    return f"pip install 'gsjax[{EXTRAS[module]}]'"
