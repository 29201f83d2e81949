"""What is tried to break the commands, part by part; each part lists the rows of its table."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from breaking import damage, disks, memory, soak, stops, worlds
from breaking.commands import Rows


class Part(NamedTuple):
    """One table: its heading, its columns, and how its rows come about in a folder."""

    title: str
    columns: tuple[str, ...]
    rows: Callable[[Path], Rows]


PARTS = {
    module.__name__.rpartition(".")[2]: Part(module.TITLE, module.COLUMNS, module.rows)
    for module in (stops, disks, damage, worlds, memory, soak)
}
