"""How every command's help looks: what goes in and comes out, the options, one example."""

import argparse
import inspect
import math
import re
from collections.abc import Callable

from gsjax.errors import InputError
from gsjax.scene.georeference import parse_length

UNITS = {"s": 1, "m": 60, "h": 3600}


def add_command(
    commands: argparse._SubParsersAction,
    name: str,
    run: Callable[[argparse.Namespace], int | None],
    *,
    summary: str,
    description: str,
    example: str,
    packages: tuple[str, ...] = (),
    listing: Callable[[], str] | None = None,
) -> argparse.ArgumentParser:
    """Adds a command that `run` carries out, whose exit code may be its own; the caller adds its arguments.

    `packages` are those of the extras that the command cannot do without: it ends at once where one is absent. The help
    has what `listing` returns before the example. It is called when the help is printed: its imports delay no
    command.
    """
    parser = commands.add_parser(
        name,
        help=summary,
        description=inspect.cleandoc(description),
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run, packages=packages)
    if listing is not None:
        usual = parser.format_help

        def format_help() -> str:
            parser.epilog = f"{listing()}\n\nexample:\n  {example}"
            return usual()

        parser.format_help = format_help
    return parser


def add_moved_scene(parser: argparse.ArgumentParser) -> None:
    """Add `--scene`, where the data set of a run is now."""
    parser.add_argument("--scene", metavar="SCENE", dest="scene_folder", help="where the data set of RUN is, if it was"
        " moved since the training")  # fmt: skip


def given_options(arguments: argparse.Namespace, *names: str) -> dict:
    """The named options that the user gave: the defaults of the others are the library's."""
    return {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}


def count(text: str) -> int:
    """A number of things, 1 at least; as the `type` of an argument.

    Raises:
        argparse.ArgumentTypeError: It is none.
    """
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text}: not a whole number of at least 1")
    return int(text)


def finite(text: str) -> float:
    """A number that is neither infinite nor none; as the `type` of an argument.

    Raises:
        argparse.ArgumentTypeError: It is no such number.
    """
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{text}: not a finite number")
    return number


def metres(text: str) -> float:
    """Metres of a length such as `1.25m`, `80cm` or `3ft`; as the `type` of an argument.

    Raises:
        argparse.ArgumentTypeError: It is none, or nothing.
    """
    try:
        return parse_length(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def seconds(budget: str) -> float:
    """Seconds of a time such as `90s`, `10m` or `1.5h`.

    Raises:
        InputError: It is none, or nothing.
    """
    found = re.fullmatch(r"(\d+(?:\.\d+)?|\.\d+)([smh])", budget.strip())
    number = float(found[1]) * UNITS[found[2]] if found else 0.0
    if not 0 < number < math.inf:
        raise InputError(f"--budget {budget}: not a time, such as 90s, 10m or 1.5h")
    return number
