"""How every command's help looks: what goes in and comes out, the options, one example."""

import argparse
import inspect
from collections.abc import Callable


def add_command(
    commands: argparse._SubParsersAction,
    name: str,
    run: Callable[[argparse.Namespace], None],
    *,
    summary: str,
    description: str,
    example: str,
) -> argparse.ArgumentParser:
    """Adds a command that `run` carries out; the caller adds its arguments to the returned parser."""
    parser = commands.add_parser(
        name,
        help=summary,
        description=inspect.cleandoc(description),
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run)
    return parser


def given(arguments: argparse.Namespace, *names: str) -> dict:
    """The named options that the user gave: the defaults of the others are the library's."""
    return {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
