"""`python -m gsjax` is the command `gsjax`."""

from gsjax.cli import main
from gsjax.cli.stopping import leave, skip_teardown


def run() -> None:
    """What the shell calls."""
    skip_teardown()
    leave(main())


if __name__ == "__main__":
    run()
