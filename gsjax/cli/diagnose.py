"""Report which effects the photos of a data set show.

Reads every photo once, and the tracks of structure from motion where there are any:
exposure and white balance, vignetting, background, open sky, poses, transients, blur. Prints for
each the evidence with its noise, the threshold, the decision, and why; and how far apart the
photos are. Maps that `gsjax normals` made are judged too: whether they are multi-view
consistent. Nothing is trained. An effect that cannot be judged is off, with the reason.

Example: gsjax diagnose scenes/garden --json garden.json
"""

from typing import Any

from gsjax.cli.parsers import Command, finite


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("scene", metavar="SCENE", help="folder of the data set")
    add("--json", metavar="FILE", help="also write it here, and pictures of the evidence next to it (.png)")
    add("--downscale", type=finite, metavar="K", help="read the photos K times smaller (default: 1)")
    add("--images", metavar="FOLDER", help="folder of the photos, within SCENE or absolute (default: found by name)")


def run(scene: str, **options: Any) -> str:
    """Diagnose; return the tables."""
    from gsjax.pipeline.diagnose import apart_line, diagnose, normals_rows, rows
    from gsjax.report.tables import align_columns

    record = diagnose(scene, **options)
    parts = [align_columns(rows(record)), apart_line(record["apart"])]
    if normals := normals_rows(record):
        parts.append(align_columns(normals))
    return "\n\n".join(parts)
