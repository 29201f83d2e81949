"""Commands stopped at random moments, and called again: the same bits, and nothing half-written."""

import random
import shutil
import signal
import sys
import time
from functools import partial
from pathlib import Path

from breaking.commands import (
    COMMANDS,
    NEVER,
    RESUME,
    Command,
    Rows,
    finished,
    leftovers,
    prepare,
    products,
    start_command,
    whole,
)

TITLE = "Stopped at random moments, called again"
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
COLUMNS = "Command", *(number.name for number in SIGNALS)
CODES = {signal.SIGKILL: {-9}, signal.SIGTERM: {143, -15}, signal.SIGINT: {130, -2}}
"""How a command ends that is stopped: by itself, or, before it has begun, by the signal."""
CELL, TIMES, A_TRY = 12, range(1, 7), 1.7
"""Seconds for a cell, how often a command may be stopped by each signal, and how many calls of it a try takes."""


def rows(folder: Path) -> Rows:
    """A row a command."""
    return {f"`{name}`": [partial(_stopped, folder / "work", name, number) for number in SIGNALS] for name in COMMANDS}


def _stopped(folder: Path, name: str, number: signal.Signals) -> list[str]:
    seconds, chance = whole(folder, name), random.Random(f"{name} {number.name}")
    times = min(max(int(CELL / (A_TRY * seconds)), TIMES[0]), TIMES[-1])
    moments = [chance.uniform(0.05, 1.0) * seconds for _ in range(times)]
    successes = sum(_survives(folder, name, number, moment, f"{number.name}_{i}") for i, moment in enumerate(moments))
    return [f"{successes} of {times}"]


def _survives(folder: Path, name: str, number: signal.Signals, moment: float, mark: str) -> bool:
    """Stops the command once, after so many seconds, and calls it again."""
    command = COMMANDS[name]
    out = f"{mark}/{command.out}"  # Pages name the folder of a run.
    prepare(folder, command, out)
    process = start_command(folder, command, out)
    time.sleep(moment)
    process.send_signal(number)
    code, stderr = finished(process)
    fair = code in CODES[number] | {0} and (code in (0, -2) or "Traceback" not in stderr)
    if name == "demo":  # It asks for the folder to be removed.
        shutil.rmtree(folder / out, ignore_errors=True)
    done = _same(folder, command, out)
    if command.again != NEVER:
        more = ("--resume",) if command.again == RESUME and (folder / out).exists() else ()
        again, stderr_again = finished(start_command(folder, command, out, *more))
        stderr += stderr_again
        fair = fair and (again == 0 or (done and again == 2))  # Which says that it is there.
    same = fair and _same(folder, command, out)
    left = leftovers(folder)
    if not (fair and same and not left):
        print(f"{name}, {number.name} after {moment:.2f} s: code {code}, same {same}, left {left}\n{stderr[-3000:]}",
              file=sys.stderr)  # fmt: skip
        return False
    shutil.rmtree(folder / mark, ignore_errors=True)
    return True


def _same(folder: Path, command: Command, out: str) -> bool:
    """Whether the products are there, and those of a call that was not stopped."""
    expected = products(folder, command, command.out)
    here = (folder / out).parent
    return all((here / name).is_file() for name in expected) and products(folder, command, out) == expected
