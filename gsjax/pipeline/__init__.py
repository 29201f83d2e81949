"""The whole road as plain functions: what the command line and notebooks call."""

from gsjax.pipeline.convert import convert
from gsjax.pipeline.diagnose import diagnose
from gsjax.pipeline.evaluate import evaluate
from gsjax.pipeline.mesh import mesh
from gsjax.pipeline.normals import normals
from gsjax.pipeline.pictures import render
from gsjax.pipeline.refine import refine
from gsjax.pipeline.scan import scan
from gsjax.pipeline.texture import texture, turntable
from gsjax.pipeline.train import train
from gsjax.pipeline.undistort import undistort

__all__ = [
    "convert",
    "diagnose",
    "evaluate",
    "mesh",
    "normals",
    "refine",
    "render",
    "scan",
    "texture",
    "train",
    "turntable",
    "undistort",
]
