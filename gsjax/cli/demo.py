"""Train and mesh a built-in scene with and without the surface terms, and compare.

Renders a built-in scene with exact depth and normals, trains it twice from the same start
(vanilla, and with the surface terms and the true normals), extracts both meshes and writes
report.json and pictures side by side. Needs no data and takes minutes on a CPU.

Example: gsjax demo --out runs/demo
"""

from gsjax.cli.parsers import Command

COLUMNS = ("psnr", "ssim", "normal_error_deg", "normal_error_all_deg", "chamfer", "fscore", "normal_consistency",
         "gaussians", "seconds")  # fmt: skip

PACKAGES = ("open3d", "trimesh", "pycolmap", "matplotlib")


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    parser.add_argument("--out", metavar="DIR", default="runs/demo", help="folder for the results (default: runs/demo)")


def run(out: str) -> str:
    """Train, mesh and compare; return the table."""
    from gsjax.pipeline import demo
    from gsjax.report import tables

    report = demo.run(out)
    rows = {"vanilla": report["vanilla"], "surface": report["surface"], tables.FLOOR: report["floor"]}
    table = tables.compare({name: {key: row[key] for key in COLUMNS if key in row} for name, row in rows.items()})
    return f"{table}\nnormals of the surface terms: the true ones of the scene\nreport and pictures: {out}"
