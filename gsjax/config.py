"""From nested dicts to frozen dataclasses and back; a wrong key or value is named where it is.

Configuration is data at the edge: a base dict, small differences merged over it, `key=value` overrides from the
command line, and one `parse` that checks everything. No function of the method takes a config.
"""

import dataclasses
import difflib
import functools
import json
import math
import os
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

from gsjax.errors import InputError

T = TypeVar("T")
MOST_INTEGER = 2**53  # As floats hold them; where less is sensible, the dataclass says so.


def parse(cls: type[T], data: Mapping[str, Any], *, where: str = "config") -> T:
    """An instance of a (nested) dataclass from plain data; absent keys take the dataclass's defaults.

    Fields may be dataclasses, `int`, `float` (an integer will do), `bool`, `str`, `None`, unions of them,
    `Literal`, `tuple[X, ...]`, `tuple[X, Y]` and `dict[str, X]`. Ranges are checked by the dataclasses themselves:
    a `ValueError` of a `__post_init__` becomes an `InputError` that says where.

    Raises:
        InputError: An unknown or missing key, or a value of the wrong type or range. The message holds `where`, which
            is the name of the data's file, or `--set`; the dotted key, and the nearest known one or the expected type.
    """
    return _Parser(cls, where).dataclass(cls, data, "")


def parse_overridden(cls: type[T], data: Mapping[str, Any], assignments: Sequence[str]) -> T:
    """As `parse`, with the assignments of `--set` made (`override`), which also reach into defaults that are lists."""
    whole = to_dict(parse(cls, data, where="settings"))
    return parse(cls, override(whole, assignments), where="--set")


def as_record(cls: type[T], value: T | Mapping[str, Any]) -> T:
    """A record as it is, or parsed from a table of its fields.

    Raises:
        InputError: It is neither, or as in `parse`.
    """
    return value if isinstance(value, cls) else parse(cls, value, where=cls.__name__)


def parse_numbers(numbers: Mapping[str, Any], *, where: str) -> dict[str, float]:
    """A table of finite numbers, as `parse` reads one.

    Raises:
        InputError: One of them is something else; the message holds `where` and its name.
    """
    return _Parser(float, where).value(dict[str, float], numbers, "")


def declare_types(record: Any) -> None:
    """Convert every field of a dataclass to its declared type, as `parse` does; what its `__post_init__` begins with.

    Records that a program makes hold numpy's numbers, paths, lists and tables as naturally as a file holds plain data.

    Raises:
        InputError: A field is of another type.
    """
    parser = _Parser(type(record), type(record).__name__)
    for name, hint in _hints(type(record)).items():
        value = getattr(record, name)
        is_union = typing.get_origin(hint) in (typing.Union, types.UnionType)
        if type(value) not in (typing.get_args(hint) if is_union else (hint,)):
            object.__setattr__(record, name, parser.value(hint, value, name))


def refuse_moved(cls: Any, data: Mapping[str, Any], *, where: str) -> None:
    """Raise InputError for a key that has moved: `cls.moved`, where a dataclass has such a table, says where to.

    A key that names a group of fields today was a value: as a table or a record it is today's.
    """
    for key, now in getattr(cls, "moved", {}).items():
        is_table = isinstance(data.get(key), Mapping) or dataclasses.is_dataclass(data.get(key))
        if key in data and not (is_table and key in cls.__dataclass_fields__):
            raise InputError(f"{where}: {key} is {now} now")


def merge(base: Mapping[str, Any], *differences: Mapping[str, Any]) -> dict[str, Any]:
    """A new nested dict: later values win, mappings are merged key by key, lists are replaced.

    A mapping over a list of records changes those it names: `{"phases": {"surface": {"steps": 100}}}`.
    """
    merged = dict(base)
    for difference in differences:
        for key, value in difference.items():
            merged[key] = _merged(merged.get(key), value)
    return merged


def _merged(before: Any, value: Any) -> Any:
    if not isinstance(value, Mapping):
        return value
    if isinstance(before, Mapping):
        return merge(before, value)
    if not isinstance(before, list | tuple) or not all(isinstance(item, Mapping) for item in before):
        return value
    items = list(before)
    for part, change in value.items():
        place = _place(items, part)
        if place is None:
            raise InputError(f"'{part}' is none of {_names(items)}")
        items[place] = _merged(items[place], change)
    return items


def override(data: Mapping[str, Any], assignments: Sequence[str]) -> dict[str, Any]:
    """`data` with every `dotted.key=value` set; a value is read as JSON where it is JSON, else as a string.

    List items are reached by name (`phases.surface.steps=100`) or number (`phases.0.steps=100`) where `data` holds the
    list. Whether a key exists is for `parse` to say.

    Raises:
        InputError: An assignment without `=`, or through something that has no keys.
    """
    result = _plain(data)
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals or not key:
            raise InputError(f"--set {assignment}: expected key=value, for example --set seed=3")
        *parents, last = key.split(".")
        target = result
        for part in parents:
            target = _child(target, part, assignment)
        target[_index(target, last, assignment)] = _value(text)
    return result


def to_dict(settings: Any) -> dict[str, Any]:
    """The nested dict, ready for JSON, from which `parse` makes an equal dataclass."""
    return {f.name: _plain(getattr(settings, f.name)) for f in dataclasses.fields(settings)}


class _Parser:
    """Holds what every message needs: the name of the source, and all keys that there are."""

    def __init__(self, root: type, where: str):
        self.where, self.root = where, root

    def dataclass(self, cls: Any, data: Any, at: str) -> Any:
        if not isinstance(data, Mapping):
            raise self.mismatch(at, data, "a table of keys")
        refuse_moved(cls, data, where=self.where)
        hints = _hints(cls)
        fields = {f.name: f for f in dataclasses.fields(cls) if f.init}
        for key in data:
            if key not in fields:
                raise self.unknown(_join(at, key), [_join(at, name) for name in fields])
        for name, field in fields.items():
            required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
            if required and name not in data:
                raise InputError(f"{self.where}: key '{_join(at, name)}' is missing")
        values = {key: self.value(hints[key], value, _join(at, key)) for key, value in data.items()}
        try:
            return cls(**values)
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{self.where}: {at + ': ' if at else ''}{error}") from error

    def value(self, hint: Any, value: Any, at: str) -> Any:
        value = _python_number(value)
        origin, arguments = typing.get_origin(hint), typing.get_args(hint)
        if dataclasses.is_dataclass(hint):
            return value if isinstance(value, hint) else self.dataclass(hint, value, at)
        if origin in (typing.Union, types.UnionType):
            return self.first_that_fits(arguments, value, at, hint)
        if origin is typing.Literal:
            if not any(value == a and type(value) is type(a) for a in arguments):
                raise self.mismatch(at, value, _named(hint))
            return value
        if origin is tuple:
            return self.tuple(arguments, value, at, hint)
        if origin in (dict, Mapping) and isinstance(value, Mapping):
            return {str(key): self.value(arguments[1], item, _join(at, key)) for key, item in value.items()}
        if type(value) is int and hint in (int, float) and abs(value) > MOST_INTEGER:
            raise InputError(f"{self.where}: {at or 'the whole'} is an integer beyond {MOST_INTEGER}")
        if hint is float and type(value) is int:
            return float(value)
        if hint is float and isinstance(value, float) and not math.isfinite(value):
            raise self.mismatch(at, value, "a finite number")
        if hint is str and isinstance(value, os.PathLike):
            return os.fspath(value)
        if hint is types.NoneType and value is None:
            return None
        # bool is a subclass of int, and never meant as one.
        if isinstance(hint, type) and isinstance(value, hint) and (hint is bool) == isinstance(value, bool):
            return value
        raise self.mismatch(at, value, _named(hint))

    def first_that_fits(self, hints: Sequence[Any], value: Any, at: str, union: Any) -> Any:
        tables = [hint for hint in hints if dataclasses.is_dataclass(hint)]
        if len(tables) == 1 and isinstance(value, Mapping):
            return self.value(tables[0], value, at)  # Its own message says more than "does not fit".
        # An exact type first, so that 3 stays an int in `float | int`.
        for hint in sorted(hints, key=lambda hint: hint is not type(value)):
            try:
                return self.value(hint, value, at)
            except InputError:
                continue
        raise self.mismatch(at, value, _named(union))

    def tuple(self, arguments: Sequence[Any], value: Any, at: str, hint: Any) -> tuple:
        if not isinstance(value, list | tuple):
            raise self.mismatch(at, value, _named(hint))
        hints = [arguments[0]] * len(value) if arguments[1:] == (...,) else list(arguments)
        if len(hints) != len(value):
            raise self.mismatch(at, value, _named(hint))
        return tuple(self.value(h, item, _join(at, i)) for i, (h, item) in enumerate(zip(hints, value, strict=True)))

    def unknown(self, key: str, siblings: Sequence[str]) -> InputError:
        def likeness(candidate: str) -> float:
            whole = difflib.SequenceMatcher(None, key, candidate).ratio()
            last = difflib.SequenceMatcher(None, key.split(".")[-1], candidate.split(".")[-1]).ratio()
            return max(whole, last)

        candidates = [*siblings, *_dotted_keys(self.root)]
        if not candidates:
            return InputError(f"{self.where}: unknown key '{key}'; there are no keys here")
        nearest = max(candidates, key=likeness)
        return InputError(f"{self.where}: unknown key '{key}'; the nearest known one is '{nearest}'")

    def mismatch(self, at: str, value: Any, expected: str) -> InputError:
        return InputError(f"{self.where}: {at or 'the whole'} is {value!r}, expected {expected}")


@functools.cache
def _hints(cls: type) -> dict[str, Any]:
    return typing.get_type_hints(cls)


def _python_number(value: Any) -> Any:
    """A number of numpy or jax, also in an array without axes, as Python's; anything else as it is.

    One that jax traces has no value, and is refused where a number is expected.
    """
    if getattr(value, "shape", None) != ():
        return value
    try:
        return value.item()
    except Exception:
        return value


def _dotted_keys(cls: Any, prefix: str = "") -> Iterator[str]:
    """Every key that a table of `cls` may hold, nested ones included."""
    for name, hint in _hints(cls).items():
        key = _join(prefix, name)
        yield key
        for inner in (hint, *typing.get_args(hint)):
            if dataclasses.is_dataclass(inner) and typing.get_origin(hint) is not tuple:
                yield from _dotted_keys(inner, key)


def _join(at: str, key: object) -> str:
    return f"{at}.{key}" if at else str(key)


def _named(hint: Any) -> str:
    """A type as a person would write it."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Literal:
        return "one of " + ", ".join(json.dumps(a) for a in arguments)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_named(a) for a in arguments)
    if origin is tuple and arguments[1:] == (...,):
        return f"a list of {_named(arguments[0])}"
    if origin is tuple:
        return f"a list of {len(arguments)}: {', '.join(_named(a) for a in arguments)}"
    if dataclasses.is_dataclass(hint) or origin in (dict, Mapping):
        return "a table of keys"
    return "null" if hint is types.NoneType else getattr(hint, "__name__", str(hint))


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return to_dict(value)
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):  # No JSON, an integer of thousands of digits, or thousands of brackets.
        return text


def _child(target: Any, part: str, assignment: str) -> Any:
    """What `part` names inside `target`: a new table where a table has nothing yet."""
    index = _index(target, part, assignment)
    if isinstance(target, dict) and target.get(index) is None:
        target[index] = {}
    return target[index]


def _index(target: Any, part: str, assignment: str) -> Any:
    """`part` as a key of a table or a place in a list."""
    if isinstance(target, dict):
        return part
    if isinstance(target, list):
        place = _place(target, part)
        if place is not None:
            return place
        if all(isinstance(item, dict) and "name" in item for item in target):
            raise InputError(f"--set {assignment}: '{part}' is none of {_names(target)}")
    raise InputError(f"--set {assignment}: '{part}' is no key or place in {json.dumps(target)}")


def _place(items: Sequence[Any], part: str) -> int | None:
    """Where an item of a list is that is named by its `name` or by its number; None: nowhere."""
    named = [place for place, item in enumerate(items) if isinstance(item, Mapping) and item.get("name") == part]
    if named:
        return named[0]
    return int(part) if str(part).isdecimal() and int(part) < len(items) else None


def _names(items: Sequence[Any]) -> str:
    """The names and numbers that reach the items of a list."""
    named = (item.get("name") for item in items if isinstance(item, Mapping))
    return ", ".join([*(str(name) for name in named if name), *map(str, range(len(items)))])
