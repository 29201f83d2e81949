"""Packages that only some ways in need: loaded where they are used, and missed in one line."""

import importlib
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
        return importlib.import_module(module)
    except (ImportError, OSError) as error:
        raise InputError(f"cannot load {module} ({str(error).splitlines()[0]}); install it with: {install}") from error
