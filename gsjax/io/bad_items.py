"""One policy for photos, frames and points that cannot be used: they are left out and named, unless too few remain."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from gsjax.errors import InputError, one_line
from gsjax.io.notices import print_once

FEWEST = 2
"""Photos that any data set must have."""
_SHOWN = 5  # names in a line

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
        needed: How many must remain. None: half of them, and `FEWEST`.

    Raises:
        InputError: Fewer remain.
    """
    if not faults:
        return
    names = ", ".join(fault.name for fault in faults[:_SHOWN]) if len(faults) > 1 else ""
    more = f" and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else ""
    _settle(faults[0].reason, kind, len(faults), total, needed, f": {names}{more}" if names else "")


def leave_out_rows(where: object, kind: str, usable: np.ndarray) -> None:
    """As `leave_out`, of rows that hold values which are not finite: those where `usable` `[N]` is False."""
    bad = int((~usable).sum())
    if bad:
        _settle(f"{where}: holds values that are not finite", kind, bad, len(usable), None, "")


def _settle(reason: str, kind: str, bad: int, total: int, needed: int | None, names: str) -> None:
    needed = max(FEWEST, (total + 1) // 2) if needed is None else needed
    if total - bad < needed:
        raise InputError(f"{reason}; {bad} of {total} {kind} cannot be used, and {needed} are needed{names}")
    print_once(one_line(f"{reason}; {bad} of {total} {kind} {'is' if bad == 1 else 'are'} left out{names}"))
