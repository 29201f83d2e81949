"""Every command's help."""

import subprocess
import sys
from pathlib import Path

from breaking.commands import Rows, environment

TITLE = "Help"
COLUMNS = "Asked for", "Held"
HEAVY = "jax", "scipy", "cv2", "numba", "matplotlib", "trimesh", "open3d", "pycolmap", "viser", "optax", "PIL"
NAMES = "from gsjax import cli; print(*cli.parser()._subparsers._group_actions[0].choices)"
HELP = f"""
import sys
from gsjax import cli
sys.exit(cli.main([sys.argv[1], "--help"]) or any(name in sys.modules for name in {HEAVY}))
"""


def rows(folder: Path) -> Rows:
    """One row for all."""
    return {"`--help` of every command, without anything heavy imported": [lambda: [_helped(folder)]]}


def _helped(folder: Path) -> str:
    def ran(program: str, *arguments: str) -> subprocess.CompletedProcess:
        command = [sys.executable, "-c", program, *arguments]
        return subprocess.run(command, env=environment(folder), capture_output=True, text=True)

    codes = [ran(HELP, name).returncode for name in ran(NAMES).stdout.split()]
    return f"{codes.count(0)} of {len(codes)}"
