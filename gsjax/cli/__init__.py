"""The command line: one small file per command, each calling one function of the library."""

import argparse
import errno
import signal
from collections.abc import Callable, Sequence

from gsjax.cli import (
    blocks,
    clean,
    compare,
    convert,
    demo,
    diagnose,
    doctor,
    environment,
    evaluate,
    masks,
    mesh,
    normals,
    refine,
    render,
    report,
    scale,
    scan,
    sfm,
    share,
    texture,
    train,
    undistort,
    view,
)
from gsjax.cli.printing import Printing, open_closed_streams, tell
from gsjax.cli.stopping import ASKS, Stopping
from gsjax.errors import InputError, is_out_of_memory

OF_A_NAME = {errno.ENAMETOOLONG, errno.EACCES, errno.EPERM}
"""What the system says of files and folders that nobody may look at, or that cannot be."""

DESCRIPTION = """Photos to 3D Gaussians and a clean mesh.

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
  scene --diagnose--> which effects its photos call for
  scene --normals--> a normal map a photo, from a network, for training
  photos or scene --masks--> what to leave out of each photo, from a network
  scene --undistort--> scene of pinhole photos, for other programs
  run or file of Gaussians --clean--> the same without floaters, crumbs and giants
  run or file of Gaussians --convert--> .ply, .compressed.ply, .sog or .spz
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: Arguments without the program's name; None reads `sys.argv`.

    Returns:
        The exit code, as `run_guarded` has it; 2 for wrong arguments too.
    """
    try:
        arguments = parser().parse_args(argv)
    except SystemExit as stop:  # After --help, or with argparse's own message about the arguments.
        return int(stop.code or 0)
    return run_guarded(lambda: arguments.run(arguments))


def run_guarded(action: Callable[[], int | None]) -> int:
    """Prepares jax's environment, runs an action and turns what ended it into an exit code.

    Returns:
        0 done, or what the action returns, 2 unusable input (one line on stderr says which). Asked to end, it cleans up
        as after any other end, and leaves with the code that shells give to the signal: 130 after Ctrl-C, 143 after
        SIGTERM; 141 where a pipe that it prints to was closed. Anything else is a bug and comes up as the exception
        that it is.
    """
    open_closed_streams()
    stopping, printing = Stopping(), Printing()
    try:
        environment.require_unix()
        environment.prepare()
        with stopping, printing:
            code = action()
    except InputError as error:
        tell(f"gsjax: error: {error}")
        return 2
    except BaseException as error:
        # Also what others have made of our exception, such as XLA of one in its callback.
        asked = stopping.signal or (signal.SIGINT if isinstance(error, KeyboardInterrupt) else None)
        if asked is None:
            if (fault := _fault_of_the_machine(error)) is not None:
                tell(f"gsjax: error: {InputError(fault)}")
                return 2
            if (code := printing.exit_code(error)) is not None:
                return code
            raise
        tell(f"gsjax: {ASKS[asked]}")
        return 128 + asked
    return code or 0


def _fault_of_the_machine(error: BaseException) -> str | None:
    """What neither the input nor a bug is to blame for, in words; None for any other error."""
    if isinstance(error, OSError) and error.errno in OF_A_NAME and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, FileNotFoundError) and environment.is_called_nowhere():
        return "the folder in which this was called is no more; go to another one"
    if is_out_of_memory(error):
        return "memory has ended; smaller photos (--downscale), fewer Gaussians or fewer other programs leave more"
    return None


def parser() -> argparse.ArgumentParser:
    """The parser of all commands; `arguments.run(arguments)` runs the one that was given."""
    top = _Parser(prog="gsjax", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    top.add_argument("--version", action=_Version, help="say versions, device and engine, and exit")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=_Command)
    beside_training = diagnose, normals, masks, undistort, convert, doctor
    for command in (
        demo,
        scan,
        sfm,
        scale,
        train,
        blocks,
        mesh,
        refine,
        texture,
        evaluate,
        render,
        report,
        compare,
        clean,
        view,
        share,
        *beside_training,
    ):
        command.add_to(commands)
    return top


class _Version(argparse.Action):
    """Says versions, device and engine without loading jax."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None):
        super().__init__(option_strings, dest, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from gsjax.io.installation import version_line

        print(version_line())
        parser.exit()


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, and where to read more, instead of repeating the usage."""

    def error(self, message: str):
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


class _Command(_Parser):
    """Says of an option that it does not have where its own are told; argparse would name the help of all commands."""

    def parse_known_args(self, args=None, namespace=None):
        arguments, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return arguments, unknown
