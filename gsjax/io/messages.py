"""Messages to the user: one line on stderr, printed once."""

import sys
from collections.abc import Callable, Hashable, Sequence

from tqdm import tqdm


def _print(line: str) -> None:
    tqdm.write(line.encode(errors="backslashreplace").decode(), file=sys.stderr)  # above a bar, if there is one


_show: Callable[[str], None] = _print
_noticed: set[Hashable] = set()


def first_names(names: Sequence[str], most: int = 5) -> str:
    """The first names of a list, and how many more there are, for a message."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def show_with(show: Callable[[str], None]) -> None:
    """Makes `show` receive the lines of this process, in place of stderr."""
    global _show
    _show = show


def print_once(line: str) -> None:
    """Prints a line; once, however often a command loads the data set."""
    print_first(line, line)


def print_first(kind: Hashable, line: str) -> None:
    """Prints a line on the first item of a kind, and none on the others: a fault that many photos share."""
    if kind not in _noticed:
        _noticed.add(kind)
        _show(line)
