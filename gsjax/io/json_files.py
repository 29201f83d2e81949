"""JSON files: whole or absent, and read with one line for what is wrong with one."""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gsjax.errors import InputError
from gsjax.io.files import atomic_path, read_bytes
from gsjax.io.json_shapes import Shape, check

MOST_DIGITS = 19  # of an integer: nothing that is counted has more, and floats hold it


def write(path: str | Path, data: Any) -> None:
    """Writes indented JSON; numpy and jax scalars become numbers, arrays lists, NaN and infinities null."""
    text = json.dumps(plain(data), indent=2, allow_nan=False) + "\n"
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read(path: str | Path, shape: Shape = object) -> Any:
    """What a JSON file holds; a byte order mark before it is no fault.

    Raises:
        InputError: The file is absent, is no JSON, is nested too deeply, or has not the shape (`json_shapes.Shape`).
    """
    try:
        return parse(path, read_bytes(path).decode("utf-8-sig"), shape)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is no JSON (not in UTF-8 from byte {error.start} on)") from error


def parse(where: object, text: str, shape: Shape = object) -> Any:
    """What a JSON text holds; `where` names it in messages."""
    try:
        value = json.loads(text, parse_int=_integer)
    except ValueError as error:
        raise InputError(f"{where}: is no JSON ({str(error).splitlines()[0]})") from error
    except RecursionError:
        raise InputError(f"{where}: is nested too deeply") from None
    check(where, value, shape)
    return value


def _integer(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise ValueError(f"an integer of {len(digits)} characters")
    return int(digits)


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
