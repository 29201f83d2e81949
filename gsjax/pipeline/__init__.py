"""The commands as functions: what the command line and notebooks call."""

from gsjax.pipeline.blocks import blocks
from gsjax.pipeline.clean import clean
from gsjax.pipeline.compare import compare
from gsjax.pipeline.convert import convert
from gsjax.pipeline.diagnose import diagnose
from gsjax.pipeline.evaluate import evaluate
from gsjax.pipeline.masks import masks
from gsjax.pipeline.mesh import mesh
from gsjax.pipeline.normals import normals
from gsjax.pipeline.refine import refine
from gsjax.pipeline.render import render
from gsjax.pipeline.scale import scale
from gsjax.pipeline.scan import scan
from gsjax.pipeline.share import share
from gsjax.pipeline.texture import texture
from gsjax.pipeline.train import train
from gsjax.pipeline.undistort import undistort
from gsjax.planning.budget import budgeted, resized, scaled
from gsjax.report.page import record_stage, report
from gsjax.training.data_parallel import count_devices

__all__ = [
    "blocks",
    "budgeted",
    "clean",
    "compare",
    "convert",
    "count_devices",
    "diagnose",
    "evaluate",
    "masks",
    "mesh",
    "normals",
    "record_stage",
    "refine",
    "render",
    "report",
    "resized",
    "scale",
    "scaled",
    "scan",
    "share",
    "texture",
    "train",
    "undistort",
]
