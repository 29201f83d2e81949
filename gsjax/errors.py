"""The exception that means: the input is at fault, and here is how; and which errors mean that memory has ended."""

MOST_CHARACTERS = 900  # of a message; names and values come from files, and may be of any length


def one_line(message: str) -> str:
    """A message as one line: what does not print is escaped, and of a very long one the middle is left out."""
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(message))
    half = MOST_CHARACTERS // 2
    return line if len(line) <= MOST_CHARACTERS else f"{line[: half - 5]} ... {line[-half:]}"


class InputError(ValueError):
    """Unusable input. Its message is one line that names the file (or option) and the fault.

    The command line prints the message and exits with code 2; as a library it is an ordinary `ValueError`. Characters
    that do not print, such as a line's end in a name, are escaped, and of a very long message the middle is left out.
    """

    def __init__(self, message: str):
        super().__init__(one_line(message))


class NoSurfaceError(InputError):
    """No surface where one is expected, as of a poor run: no file is damaged, other figures remain."""


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that the machine, or the device that jax computes on, has no memory left."""
    return isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and "RESOURCE_EXHAUSTED" in str(error))
