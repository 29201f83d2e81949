"""How every command's help looks: what goes in and comes out, the options, one example."""

import argparse
import importlib
import inspect
import math
import re
from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Any, NamedTuple

from gsjax.errors import InputError
from gsjax.scene.georeference import parse_length

UNITS = {"s": 1, "m": 60, "h": 3600}


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, and where to read more, instead of repeating the usage."""

    def error(self, message: str):
        """End with code 2 and this line."""
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


class Command(Parser):
    """Refuses an unknown option with the help of this command; argparse would name that of all commands."""

    def parse_known_args(self, args=None, namespace=None):
        """Parse what is known; the rest is an error."""
        arguments, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return arguments, unknown


class About(NamedTuple):
    """The help of a command."""

    summary: str
    description: str
    example: str
    packages: tuple[str, ...] = ()  # of extras, without one of which the command ends at once
    listing: Callable[[], str] | None = None  # is before the example; called when the help is printed


def add_command(commands: argparse._SubParsersAction, name: str) -> None:
    """Add a command: its module in `gsjax.cli` has its help, see `about_command`, and `add_arguments` for its parser.

    The module's `run` gets the arguments that were given, by name; their defaults are those of the library. What it
    returns is printed, unless it is None or an exit code. Without `run`, the function of this name in `gsjax.pipeline`
    does the work.
    """
    module = importlib.import_module(f"gsjax.cli.{name}")
    about = about_command(module)
    parser = commands.add_parser(
        name,
        help=about.summary,
        description=inspect.cleandoc(about.description),
        epilog=f"example:\n  {about.example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        argument_default=argparse.SUPPRESS,
    )
    parser.set_defaults(run=getattr(module, "run", partial(_call_library, name)), packages=about.packages)
    module.add_arguments(parser)
    if about.listing is not None:
        parser.format_help = partial(_format_with_listing, parser, about, parser.format_help)


def about_command(module: ModuleType) -> About:
    """The help of a command: `ABOUT` of its module, or the docstring: summary, description, and a line with an example.

    Next to a docstring the module may have `PACKAGES`, and a function `listing`.
    """
    if hasattr(module, "ABOUT"):
        return module.ABOUT
    summary, _, rest = (inspect.getdoc(module) or "").partition("\n\n")
    description, _, example = rest.rpartition("\n\nExample: ")
    packages, listing = getattr(module, "PACKAGES", ()), getattr(module, "listing", None)
    return About(summary[:1].lower() + summary[1:].rstrip("."), description, example, packages, listing)


def _call_library(name: str, **arguments: Any) -> Any:
    from gsjax import pipeline

    return getattr(pipeline, name)(**arguments)


def _format_with_listing(parser: argparse.ArgumentParser, about: About, usual: Callable[[], str]) -> str:
    assert about.listing is not None
    parser.epilog = f"{about.listing()}\n\nexample:\n  {about.example}"
    return usual()


def add_moved_scene(parser: argparse.ArgumentParser) -> None:
    """Add `--scene`, where the data set of a run is now."""
    parser.add_argument("--scene", metavar="SCENE", dest="scene_folder", help="where the data set of RUN is, if it was"
        " moved since the training")  # fmt: skip


def count(text: str) -> int:
    """A whole number of at least 1; as the `type` of an argument."""
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text}: not a whole number of at least 1")
    return int(text)


def finite(text: str) -> float:
    """A number that is neither infinite nor none; as the `type` of an argument."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{text}: not a finite number")
    return number


def metres(text: str) -> float:
    """Metres of a length above 0 such as `1.25m`, `80cm` or `3ft`; as the `type` of an argument."""
    try:
        return parse_length(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def seconds(budget: str) -> float:
    """Seconds of a time such as `90s`, `10m` or `1.5h`; InputError of none, or of nothing."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?|\.\d+)([smh])", budget.strip())
    number = float(match[1]) * UNITS[match[2]] if match else 0.0
    if not 0 < number < math.inf:
        raise InputError(f"--budget {budget}: not a time, such as 90s, 10m or 1.5h")
    return number
