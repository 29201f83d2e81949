"""What JSON files must look like, as data: a reader says it once, and may then take its values as they are."""

import math
from typing import Any

from gsjax.errors import InputError

Shape = Any
"""One of:

    str, bool, int, float   a value of that type; a float may be written as an integer, and is finite
    None                    null
    {"a", "b"}              one of these texts
    object                  anything
    (A, B, ...)             any of these shapes
    [A]                     a list of A
    [A, 3]                  a list of three A
    {str: A}                a table whose values are all A, whatever their keys
    {"key": A, "other?": B} a table with these keys and maybe others; a question mark: it may be absent
"""
MOST = 2**53  # of an integer, as floats hold them


def check(where: object, value: Any, shape: Shape, at: str = "") -> None:
    """Raises InputError with the first part of `value`, by its place `at` in the whole, that has not its shape."""
    if isinstance(shape, tuple):
        fitting = [option for option in shape if _is_alike(value, option)]
        if not fitting:
            raise _mismatch(where, value, shape, at)
        check(where, value, fitting[0], at)
    elif not _is_alike(value, shape):
        raise _mismatch(where, value, shape, at)
    elif isinstance(shape, list):
        for index, item in enumerate(value):
            check(where, item, shape[0], f"{at}.{index}" if at else str(index))
    elif isinstance(shape, dict):
        every = shape.get(str)
        fields = dict.fromkeys(value, every) if str in shape else shape
        for key, inner in fields.items():
            name, place = key.removesuffix("?"), f"{at}.{key}".lstrip(".").removesuffix("?")
            if name in value:
                check(where, value[name], inner, place)
            elif name == key:
                raise InputError(f"{where}: lacks '{place}'")


def _is_alike(value: Any, shape: Shape) -> bool:
    """Whether a value is of a shape at its surface."""
    if isinstance(shape, dict):
        return isinstance(value, dict)
    if isinstance(shape, set):
        return isinstance(value, str) and value in shape
    if shape is str:
        return isinstance(value, str) and _is_text(value)
    if isinstance(shape, list):
        return isinstance(value, list) and len(value) == (shape[1] if len(shape) > 1 else len(value))
    if shape is None:
        return value is None
    if shape is float:
        return (
            type(value) in (int, float) and math.isfinite(value if type(value) is float else 0) and abs(value) < 1e300
        )
    if shape is int:
        return type(value) is int and abs(value) <= MOST
    return shape is object or type(value) is shape


def _is_text(value: str) -> bool:
    """Whether a file could have it as its name: no zero in it, and no half of a character."""
    return "\0" not in value and value.encode("utf-8", "replace").decode() == value


def _mismatch(where: object, value: Any, shape: Shape, at: str) -> InputError:
    kind = {dict: "a table", list: f"a list of {len(value) if isinstance(value, list) else 0}"}.get(type(value))
    is_huge = type(value) is int and abs(value) > MOST
    description = kind or ("an integer too large" if is_huge else repr(value)[:100])
    return InputError(f"{where}: {at or 'the whole'} is {description}, expected {_named(shape)}")


def _named(shape: Shape) -> str:
    if isinstance(shape, tuple):
        return " or ".join(map(_named, shape))
    if isinstance(shape, list):
        return f"a list of {shape[1]}" if len(shape) > 1 else "a list"
    if isinstance(shape, dict):
        return "a table"
    if isinstance(shape, set):
        return f"one of {', '.join(sorted(shape))}"
    names = {str: "a text", bool: "true or false", int: "a whole number", float: "a finite number", None: "null"}
    return names[shape]
