"""Does the sky stay out of the mesh of a house that is known exactly?

    python experiments/sky_scene.py make DIR                 # photos, a COLMAP model with tracks, masks and mesh
    python experiments/sky_scene.py score DIR MESH.ply       # mesh where there is none, and the other way round

The house stands on a lawn under a sky with soft clouds (`sky_house.py`).
"""

import argparse
import json
from pathlib import Path


def main() -> None:
    """Reads the arguments, then makes the data set or prints what a mesh is off by."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("make", "score"))
    parser.add_argument("folder", metavar="DIR", type=Path, help="the data set")
    parser.add_argument("mesh", metavar="MESH.ply", type=Path, nargs="?", help="what is scored")
    given = parser.parse_args()
    if (given.what == "score") != (given.mesh is not None):
        parser.error("score takes a mesh, make takes none")

    from sky_house import make, score

    if given.what == "make":
        make(given.folder)
    else:
        print(json.dumps(score(given.folder, given.mesh), indent=1))


if __name__ == "__main__":
    main()
