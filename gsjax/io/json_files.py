"""JSON files: whole or absent, and read with one line for what is wrong with one."""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gsjax.errors import InputError
from gsjax.io.files import atomic_path


def write(path: str | Path, data: Any) -> None:
    """Writes indented JSON; numpy and jax scalars become numbers, arrays lists, NaN and infinities null.

    Raises:
        InputError: The file cannot be written.
    """
    text = json.dumps(plain(data), indent=2, allow_nan=False) + "\n"
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read(path: str | Path) -> Any:
    """What a JSON file holds.

    Raises:
        InputError: The file is absent or is no JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: is no JSON ({str(error).splitlines()[0]})") from error


def plain(value: Any) -> Any:
    """`value` in JSON's own types."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
