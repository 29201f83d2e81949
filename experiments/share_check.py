"""Does a page of `gsjax share` open, and show what the run shows? Opens it in a real browser without a display.

    python experiments/share_check.py page.html --run RUN --out pictures [--views 3]

Needs Chromium. The page is opened from the disk, as whoever got it would, and looked at from where its first photos
were taken. What gsjax draws of RUN from the page's own keyframes stands beside it, with the PSNR between the two. Then
comes its mesh, if it has one (`shared_page.py`).
"""

import argparse
import sys
from pathlib import Path

from gsjax import tables
from gsjax.cli import run_guarded


def main() -> None:
    """Reads the arguments, prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("--run", type=Path, required=True, help="the run that the page was made of")
    parser.add_argument("--out", type=Path, required=True, help="folder for the pictures")
    parser.add_argument("--views", type=int, default=3, help="photos to look from (default: 3)")
    given = parser.parse_args()

    from shared_page import check_page

    given.out.mkdir(parents=True, exist_ok=True)
    print(tables.compare(check_page(given.page, given.run, given.out, given.views)))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
