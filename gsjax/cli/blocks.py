"""Train a large scene block by block, and merge the blocks into one run.

Divides a scene by where its cameras are (OUT/blocks.json), trains a run for each block
(OUT/block_1 and so on) with photos from its surroundings, and merges them: OUT/run, which all
other commands read. Called again, it continues where it stopped. Several machines share the work
where OUT and SCENE are folders that all of them see under one path, each with --only.

Example: gsjax blocks scenes/street --out blocks/street --blocks 4
"""

from collections.abc import Sequence
from typing import Any

from gsjax.cli.parsers import Command, count
from gsjax.cli.train import add_training, training


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("scene", metavar="SCENE", help="folder of the data set")
    add("--out", metavar="OUT", required=True, help="folder for everything; the same one again to continue")
    add("--blocks", type=count, metavar="N", required=True, help="how many, of as many cameras each")
    add("--only", type=count, nargs="+", metavar="I", help="train these blocks alone, counted from 1")
    add_training(parser, "how long to train each block")


def run(scene: str, out: str, blocks: int, only: Sequence[int] = (), **options: Any) -> dict[str, Any]:
    """Train the blocks and merge them."""
    from gsjax import pipeline

    return pipeline.blocks(scene, out, training(**options), blocks, only=only)
