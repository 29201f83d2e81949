"""What a reader did that its user should know: one line on stderr."""

import sys
from functools import cache


@cache
def print_once(line: str) -> None:
    """Prints a line; once, however often a command loads the data set."""
    print(line.encode(errors="backslashreplace").decode(), file=sys.stderr)
