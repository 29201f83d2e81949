"""The command line: one small file per command, each calling one function of the library."""

import argparse
import errno
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from gsjax.cli import environment
from gsjax.cli.parsers import Command, Parser, add_command
from gsjax.cli.stopping import SIGNALS, Stopping
from gsjax.errors import InputError, is_out_of_memory
from gsjax.io.packages import check_installed

COMMANDS = (
    "demo", "scan", "sfm", "scale", "train", "blocks", "mesh", "refine", "texture", "eval", "render", "report",
    "compare", "clean", "view", "share", "diagnose", "normals", "masks", "undistort", "convert", "doctor",
)  # fmt: skip
"""Modules of this package with a command each, in the order of the help."""
OF_A_NAME = {errno.ENAMETOOLONG, errno.EACCES, errno.EPERM}
"""Errors of files and folders whose names are too long or that this user may not read."""
WITHOUT_A_NAME = {
    errno.ENOENT: "the folder in which this was called is no more; go to another one",
    errno.ENOSPC: "what is printed cannot be written: No space left on device",
}
"""Errors that name no file: of the working folder, and of stdout."""

DESCRIPTION = """Photos to 3D Gaussians and a clean mesh.

  --demo--> a built-in scene, trained and meshed: a first try
  --doctor--> whether this installation and this machine are fit for work

  photos --scan--> all of this at once:

  photos --sfm--> scene --train--> run --mesh--> mesh.ply --refine--> mesh and Gaussians bound to it
                                    |                 `---texture--> mesh.glb with a texture
                                    |---eval---> figures
                                    |--render--> pictures and films; of files and meshes too
                                    |--report--> one page that shows it; --compare--> several runs on one
                                    |--share---> one page to send, that opens anywhere
                                    `--view----> a page to walk through it; of files and meshes too
  large scene --blocks--> the same in several runs, merged into one

  scene or run --scale--> the same in metres, by a known length
  scene --diagnose--> which effects its photos show
  scene --normals--> a normal map a photo, from a network, for training
  photos or scene --masks--> what to leave out of each photo, from a network
  scene --undistort--> scene of pinhole photos, for other programs
  run or file of Gaussians --clean--> the same without giants and isolated clusters
  run or file of Gaussians --convert--> .ply, .compressed.ply, .sog or .spz
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command; returns the exit code, as `run_guarded` has it, or 2 for wrong arguments."""
    try:
        arguments = vars(parser().parse_args(argv))
    except SystemExit as stop:  # After --help, or with argparse's own message about the arguments.
        return int(stop.code or 0)
    run, packages = arguments.pop("run"), arguments.pop("packages")

    def action() -> int | None:
        check_installed(*packages)
        return _show(run(**arguments))

    return run_guarded(action)


def _show(result: Any) -> int | None:
    """Print what a command returns, a record as a table; return an exit code as it is."""
    if result is None or isinstance(result, int):
        return result
    from gsjax.report import tables

    print(tables.record(result) if isinstance(result, dict) else result)


def run_guarded(action: Callable[[], int | None]) -> int:
    """Prepare jax's environment, run an action and turn its end into an exit code.

    Returns:
        The code that the action returns, or 0. 2 for unusable input, after one line on stderr. After a signal the
        action cleans up, and the code is that of shells: 130 for Ctrl-C, 143 for SIGTERM; 141 where the reader of
        stdout is gone. Any other exception is a bug and is raised.
    """
    stopping = Stopping()
    try:
        environment.require_unix()
        environment.prepare()
        with stopping:
            code = action()
            print(end="", flush=True)
    except InputError as error:
        return _refuse(str(error))
    except BaseException as error:
        # A library may have turned the exception of a signal into its own, as XLA does in a callback.
        number = stopping.signal or (signal.SIGINT if isinstance(error, KeyboardInterrupt) else None)
        if number is not None:
            _tell(f"gsjax: {SIGNALS[number]}")
            return 128 + number
        if isinstance(error, BrokenPipeError):  # As in `gsjax eval RUN | head -3`.
            return 128 + signal.SIGPIPE
        if (fault := _fault_of_the_machine(error)) is not None:
            return _refuse(fault)
        raise
    return code or 0


def _refuse(fault: str) -> int:
    _tell(f"gsjax: error: {fault}")
    return 2


def _tell(line: str) -> None:
    with suppress(OSError):  # The reader of stderr may be gone, too.
        print(line, file=sys.stderr)


def _fault_of_the_machine(error: BaseException) -> str | None:
    """Describe an error that is neither a fault of the input nor a bug; None for any other error."""
    if isinstance(error, OSError) and error.filename is not None and error.errno in OF_A_NAME:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.filename is None and error.errno in WITHOUT_A_NAME:
        return WITHOUT_A_NAME[error.errno]
    if is_out_of_memory(error):
        return "memory has ended; smaller photos (--downscale), fewer Gaussians or fewer other programs leave more"
    return None


def parser() -> argparse.ArgumentParser:
    """The parser of all commands; `run` is what carries out the one that was given."""
    top = Parser(prog="gsjax", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    top.add_argument("--version", action=_Version, help="say versions, device and engine, and exit")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=Command)
    for name in COMMANDS:
        add_command(commands, name)
    return top


class _Version(argparse.Action):
    """Says versions, device and engine without loading jax."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None):
        super().__init__(option_strings, dest, nargs=0, default=argparse.SUPPRESS, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from gsjax.io.installation import version_line

        print(version_line())
        parser.exit()
