"""Commands whose output is on a disk that is full before it is whole."""

import random
import sys
from functools import partial
from pathlib import Path

from breaking.commands import COMMANDS, Rows, finished, start_command, whole

TITLE = "A full disk"
COLUMNS = "Command", "Its output", "Held"
TIMES = 3
PAGE = 4096  # A file takes whole ones.
MOUNTED = """
mount -t tmpfs -o size=$(($0 + 4096)) none full && head -c 4096 /dev/zero > full/taken && "$@"
code=$?; echo >&2; find full -name ".*.gsjax-*" >&2; exit $code
"""
"""Run a command with a small disk in `full`, and list the files that a writer has left there."""


def rows(folder: Path) -> Rows:
    """A row a command that writes."""
    names = [name for name, command in COMMANDS.items() if not command.copy_of]
    return {f"`{name}`": [partial(_filled, folder / "work", name)] for name in names}


def _filled(folder: Path, name: str) -> list[str]:
    whole(folder, name)
    size = _size(folder / COMMANDS[name].out)
    chance = random.Random(name)
    sizes = [chance.randrange(0, size, PAGE) for _ in range(TIMES)]
    return [f"{size / 1e3:,.0f} kB", f"{sum(_ends_cleanly(folder, name, room) for room in sizes)} of {TIMES}"]


def _size(path: Path) -> int:
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    return sum(-(-file.stat().st_size // PAGE) * PAGE for file in files)


def _ends_cleanly(folder: Path, name: str, room: int) -> bool:
    """Calls the command with so many bytes of disk: one line says that it is full, and nothing is half-written."""
    (folder / "full").mkdir(exist_ok=True)
    before = ("unshare", "--map-root-user", "--mount", "sh", "-c", MOUNTED, str(room))
    code, stderr = finished(start_command(folder, COMMANDS[name], f"full/{COMMANDS[name].out}", before=before))
    stderr, _, left = stderr.rpartition("\n\n")
    last = stderr.rstrip().rpartition("\n")[2]
    is_clean = (
        code == 2
        and last.startswith("gsjax: error:")
        and ("No space left" in last or "bytes left" in last)
        and not left.strip()
    )
    if not is_clean:
        print(f"{name}, {room} bytes: code {code}, left {left}\n{stderr[-3000:]}", file=sys.stderr)
    return is_clean
