"""Do panoramas and fisheye photos train without seams between the faces that they are read as?

    python experiments/panoramas.py photos panorama --out DIR     # for `gsjax sfm DIR --panoramas --mask-below 60`
    python experiments/panoramas.py photos fisheye --out DIR      # a data set with the true cameras
    python experiments/panoramas.py seams RUN --out PICTURE.png   # of a run of either

The room is known exactly (`made_room.py`). `seams` draws whole photos of it from a run, and tells how far their errors
jump across the border of two faces, and between neighbours within a face (`face_seams.py`).
"""

import argparse
import sys
from pathlib import Path

from gsjax import tables
from gsjax.cli import run_guarded


def main() -> None:
    """Reads the arguments, then makes the photos or prints how much a seam shows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    photos, looks = commands.add_parser("photos"), commands.add_parser("seams")
    photos.add_argument("kind", choices=("panorama", "fisheye"))
    photos.add_argument("--out", type=Path, required=True)
    photos.add_argument("--count", type=int, default=10, help="photos (default: 10)")
    photos.add_argument("--width", type=int, default=1024, help="pixels (default: 1024)")
    looks.add_argument("run", type=Path)
    looks.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()

    if given.command == "photos":
        from made_room import write_photos

        write_photos(given.kind, given.out, given.count, given.width)
    else:
        from face_seams import seams

        print(tables.compare(seams(given.run, given.out)))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
