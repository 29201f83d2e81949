"""Packages that only some ways in need: loaded where they are used, and missed in one line."""

import importlib
import signal
import threading
from types import ModuleType

from gsjax.errors import InputError


def require(module: str, install: str) -> ModuleType:
    """Imports a package, or says what to install.

    Args:
        module: Name to import.
        install: What the user types to get it.

    Raises:
        InputError: The package, or a system library under it, is absent.
    """
    try:
        imported = importlib.import_module(module)
    except (ImportError, OSError) as error:
        raise InputError(f"cannot load {module} ({str(error).splitlines()[0]}); install it with: {install}") from error
    _answer_signals_ourselves()
    return imported


def _answer_signals_ourselves() -> None:
    """Take SIGTERM back from Google's log, which pycolmap loads: it would print a stack and clean nothing up."""
    ours = signal.getsignal(signal.SIGTERM)
    if ours is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, ours)
