"""The whole road as plain functions: what the command line and notebooks call."""

from gsjax.pipeline.budget import budgeted, resized, scaled
from gsjax.pipeline.compare import compare
from gsjax.pipeline.convert import convert
from gsjax.pipeline.diagnose import diagnose
from gsjax.pipeline.evaluate import evaluate
from gsjax.pipeline.hardware import count_devices
from gsjax.pipeline.mesh import mesh
from gsjax.pipeline.normals import normals
from gsjax.pipeline.pictures import render
from gsjax.pipeline.refine import refine
from gsjax.pipeline.report import noted, report
from gsjax.pipeline.scan import scan
from gsjax.pipeline.texture import texture, turntable
from gsjax.pipeline.train import train
from gsjax.pipeline.undistort import undistort

__all__ = [
    "budgeted",
    "compare",
    "convert",
    "count_devices",
    "diagnose",
    "evaluate",
    "mesh",
    "normals",
    "noted",
    "refine",
    "render",
    "report",
    "resized",
    "scaled",
    "scan",
    "texture",
    "train",
    "turntable",
    "undistort",
]
