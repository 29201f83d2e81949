"""One policy for photos, frames and points that cannot be used: they are left out and named, unless too few remain."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from gsjax.errors import InputError, one_line
from gsjax.io.messages import first_names, print_once

FEWEST = 2
"""Photos that any data set must have."""

T = TypeVar("T")
R = TypeVar("R")


class Fault(NamedTuple):
    """An item that cannot be used, and why."""

    name: str  # of the item, for lists
    reason: str  # names the file as well


def read_usable(items: Iterable[T], name_of: Callable[[T], str], read: Callable[[T], R]) -> tuple[list[R], list[Fault]]:
    """What `read` returns for the items that can be used, and the faults of the others, where it raises InputError."""
    usable, faults = [], []
    for item in items:
        try:
            usable.append(read(item))
        except InputError as error:
            faults.append(Fault(name_of(item), str(error)))
    return usable, faults


def leave_out(kind: str, faults: Sequence[Fault], total: int, *, needed: int | None = None) -> None:
    """Names in one line on stderr the items that are left out.

    Args:
        kind: What the items are called, in the plural.
        faults: Of those that cannot be used.
        total: How many items there are, usable or not.
        needed: How many must remain, or InputError is raised. None: half of them, and `FEWEST`.
    """
    require_enough(kind, faults, total, needed=needed)
    if faults:
        are = "is" if len(faults) == 1 else "are"
        print_once(one_line(f"{faults[0].reason}; {len(faults)} of {total} {kind} {are} left out{_names(faults)}"))


def require_enough(kind: str, faults: Sequence[Fault], total: int, *, needed: int | None = None) -> None:
    """As `leave_out`, and prints nothing: for items that a report names."""
    needed = max(FEWEST, (total + 1) // 2) if needed is None else needed
    if faults and total - len(faults) < needed:
        message = f"{faults[0].reason}; {len(faults)} of {total} {kind} cannot be used, and {needed} are needed"
        raise InputError(f"{message}{_names(faults)}")


def leave_out_rows(where: object, kind: str, usable: np.ndarray) -> None:
    """As `leave_out`, of rows that hold values which are not finite: those where `usable` `[N]` is False."""
    fault = Fault("", f"{where}: holds values that are not finite")
    leave_out(kind, [fault] * int((~usable).sum()), len(usable))


def _names(faults: Sequence[Fault]) -> str:
    """The end of a line; of one item nothing, as its reason names it, and of rows, which have no names."""
    names = [fault.name for fault in faults if fault.name]
    return f": {first_names(names)}" if len(names) > 1 else ""
