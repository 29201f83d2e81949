"""OBJ files before trimesh reads them: it takes index 0 for a vertex, and counts from the end of the whole file."""

import codecs
import re
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path

from gsjax.errors import InputError
from gsjax.io.files import read_bytes
from gsjax.io.machine import require_memory

# Possessive, so that millions of lines take a second.
_FROM_THE_END = re.compile(rb"\nf(?:[ \t/]++[0-9]++)*+[ \t/]++-")
_ZERO = re.compile(rb"\nf(?:[ \t/]++0*+[1-9][0-9]*+)*+[ \t/]++0++(?![0-9])")
_ALWAYS_ROOM = 2**24  # bytes
_COPIES = 6  # of the text, that trimesh keeps while it reads, in many forms


def prepared_obj(path: Path) -> tuple[Path | BytesIO, bool]:
    """What trimesh may read: the file itself, or what it holds without a byte order mark and with indices from 1 on.

    Args:
        path: An .obj. A face's index of -1 means the last vertex before that face.

    Returns:
        What to read, and whether the file has places in a texture.

    Raises:
        InputError: An index of a face is 0, leads before the first, or is no number, and its line is named; or the
            file cannot be read, or has no room in memory while it is.
    """
    stored = read_bytes(path)
    if len(stored) > _ALWAYS_ROOM:
        require_memory(f"{path}: an OBJ of {len(stored) / 2**30:.3g} GiB", _COPIES * len(stored))
    content = stored.removeprefix(codecs.BOM_UTF8)
    if _FROM_THE_END.search(content):
        content = b"\n".join(_from_the_start(path, content.split(b"\n")))
    if (zero := _ZERO.search(content)) is not None:
        line = 2 + content.count(b"\n", 0, zero.start())
        raise InputError(f"{path}, line {line}: a face has an index 0; OBJ counts from 1")
    return path if content is stored else BytesIO(content), b"\nvt " in content


def _from_the_start(path: Path, lines: Iterable[bytes]) -> Iterable[bytes]:
    counts = {b"v": 0, b"vt": 0, b"vn": 0}
    for number, line in enumerate(lines, 1):
        words = line.partition(b"#")[0].split()
        kind = words[0] if words else b""
        if kind in counts:
            counts[kind] += 1
        if kind != b"f":
            yield line
            continue
        try:
            yield b" ".join([b"f", *(_corner(word, counts.values()) for word in words[1:])])
        except ValueError as error:
            raise InputError(f"{path}, line {number}: {error}") from error


def _corner(word: bytes, counts: Iterable[int]) -> bytes:
    """A corner, such as -1/-1 or 3//2, with indices that count from 1."""
    return b"/".join(
        _index(part, count) if part else b"" for part, count in zip(word.split(b"/"), counts, strict=False)
    )


def _index(part: bytes, count: int) -> bytes:
    index = int(part)
    if index < -count:
        raise ValueError(f"a face has an index {index}, but only {count} come before it")
    return b"%d" % (index if index >= 0 else count + 1 + index)
