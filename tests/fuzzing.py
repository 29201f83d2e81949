"""Damaged files for the readers' tests: seeded mutations, and what every reader owes to whoever hands it one.

Each test tries a few hundred of them; `GSJAX_FUZZ=50000 python -m pytest -k fuzz` tries as many of each kind.
`GSJAX_FUZZ_DAMAGES=30` damages each in up to so many places instead of three; `GSJAX_FUZZ_LOG=FILE` appends to a file
what every test has come to, one JSON object a line.
"""

import json
import os
import re
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError

ODD_VALUES = (
    None, True, False, 0, -1, 1, 2, 0.5, 1e308, -1e308, 10**400, -(10**400), 2**31, 2**63, 2**64,
    float("nan"), float("inf"), -float("inf"), "", "x", "x" * 300, "\0", "../../x", "ä\ud800",
    [], {}, [[]], [None], [1, 2, 3], {"x": 1},
)  # fmt: skip
ODD_NUMBERS = b"0 -1 1 255 256 65536 2147483648 4294967296 18446744073709551616 1e308 1e999 -1e999 nan inf x".split()
PLACES = int(os.environ.get("GSJAX_FUZZ_DAMAGES", 3))
NUMBER = re.compile(rb"-?\d+(\.\d+)?(e-?\d+)?")


def fuzz(attempt: Callable[[np.random.Generator], Any], *, usual: int) -> tuple[int, int]:
    """Calls `attempt` with one seeded generator after another: it damages a file, and reads it.

    A reader either reads, or refuses by an InputError of one line. Anything else fails the test, with the seed.

    Args:
        attempt: What to try.
        usual: How many times; `GSJAX_FUZZ` says otherwise.

    Returns:
        How many were read, and how many refused.
    """
    counts, times = [0, 0], int(os.environ.get("GSJAX_FUZZ", usual))
    try:
        for seed in range(times):
            try:
                attempt(np.random.default_rng(seed))
                counts[0] += 1
            except InputError as error:
                assert is_one_line(str(error)), f"seed {seed}: not one line of readable length: {str(error)!r}"
                counts[1] += 1
            except Exception as error:
                raise AssertionError(f"seed {seed}: {type(error).__name__}: {error}") from error
    finally:
        _log(times, *counts)
    return counts[0], counts[1]


def fuzz_files(read: Callable[[], Any], *files: Path, usual: int) -> tuple[int, int]:
    """As `fuzz`: one of the files, which are whole, is damaged, those of JSON in their values, and `read` called."""
    whole = {file: file.read_bytes() for file in files}

    def attempt(random: np.random.Generator) -> None:
        file = files[random.integers(len(files))]
        is_json = file.suffix == ".json"
        file.write_bytes(damaged_json(json.loads(whole[file]), random) if is_json else damaged(whole[file], random))
        try:
            read()
        finally:
            file.write_bytes(whole[file])

    return fuzz(attempt, usual=usual)


def _log(times: int, read: int, refused: int) -> None:
    """What a test has come to, for who counts; the first that is neither read nor refused ends it."""
    if file := os.environ.get("GSJAX_FUZZ_LOG"):
        test = os.environ["PYTEST_CURRENT_TEST"].partition(" ")[0]
        with open(file, "a", encoding="utf-8") as log:
            log.write(json.dumps({"test": test, "tried": times, "read": read, "refused": refused}) + "\n")


def is_one_line(message: str) -> bool:
    """Whether a terminal shows a message as one line that somebody reads to its end."""
    return 0 < len(message) < 1000 and message.isprintable()


def damaged(whole: bytes, random: np.random.Generator) -> bytes:
    """A file that a disk, a network or an editor has damaged: bits, bytes, numbers, a part gone, twice or moved."""
    data = bytearray(whole)
    for _ in range(random.integers(1, 1 + PLACES)):
        if data:
            _DAMAGES[random.integers(len(_DAMAGES))](data, random)
    return bytes(data)


def damaged_json(value: Any, random: np.random.Generator) -> bytes:
    """The text of a JSON value of which a few parts have another type, size or name, or are absent, twice or deep."""
    value = json.loads(json.dumps(value))
    for _ in range(random.integers(1, 1 + PLACES)):
        value = _with_an_odd_part(value, random)
    text = json.dumps(value).encode("utf-8", "surrogatepass")
    kind = random.integers(20)
    if kind == 0:
        return damaged(text, random)
    if kind == 1:
        return b"\xef\xbb\xbf" + text
    if kind == 2:
        return text.decode("utf-8", "surrogatepass").encode("utf-16", "surrogatepass")
    if kind == 3:
        return b"[" * 100_000 + text
    return text


def _with_an_odd_part(value: Any, random: np.random.Generator) -> Any:
    """`value` with one part of it, at any depth, exchanged."""
    keys = list(value) if isinstance(value, dict) else list(range(len(value))) if isinstance(value, list) else []
    if not keys or random.random() < 0.15:
        return deepcopy(ODD_VALUES[random.integers(len(ODD_VALUES))])
    key = keys[random.integers(len(keys))]
    what = random.integers(8)
    if what == 0:
        del value[key]
    elif what == 1 and isinstance(value, list):
        value.append(deepcopy(value[key]))
    elif what == 1 and isinstance(value, dict):
        value[f"{key}x"] = value.pop(key)
    else:
        value[key] = _with_an_odd_part(value[key], random)
    return value


def _flip_a_bit(data: bytearray, random: np.random.Generator) -> None:
    data[random.integers(len(data))] ^= 1 << random.integers(8)


def _exchange_bytes(data: bytearray, random: np.random.Generator) -> None:
    start, length = random.integers(len(data)), random.integers(1, 9)
    data[start : start + length] = random.choice([bytes(length), b"\xff" * length, random.bytes(length)])


def _exchange_in_head(data: bytearray, random: np.random.Generator) -> None:
    """Where files say how much is to come."""
    data[random.integers(min(len(data), 64))] = random.choice([0, 1, 127, 128, 255])


def _exchange_a_number(data: bytearray, random: np.random.Generator) -> None:
    matches = list(NUMBER.finditer(bytes(data[:4096])))
    if matches:
        match = matches[random.integers(len(matches))]
        data[match.start() : match.end()] = ODD_NUMBERS[random.integers(len(ODD_NUMBERS))]


def _cut(data: bytearray, random: np.random.Generator) -> None:
    del data[random.integers(len(data)) :]


def _take_out(data: bytearray, random: np.random.Generator) -> None:
    start = random.integers(len(data))
    del data[start : start + random.integers(1, 65)]


def _repeat(data: bytearray, random: np.random.Generator) -> None:
    start = random.integers(len(data))
    part = data[start : start + random.integers(1, 65)]
    place = random.integers(len(data))
    data[place:place] = part


def _exchange_a_word(data: bytearray, random: np.random.Generator) -> None:
    words = list(re.finditer(rb"[A-Za-z_]\w*", bytes(data[:4096])))
    if words:
        one, other = (words[random.integers(len(words))] for _ in range(2))
        data[one.start() : one.end()] = other[0]


_DAMAGES = (
    _flip_a_bit, _exchange_bytes, _exchange_in_head, _exchange_a_number, _cut, _take_out, _repeat, _exchange_a_word,
)  # fmt: skip
