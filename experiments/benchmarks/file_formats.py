"""What does every file format make of the Gaussians of a run: size, what is clipped, how like the plain file it looks?

    python experiments/benchmarks/file_formats.py RUN --out DIR [--views 3]

RUN is a folder that `gsjax train` made. Leaves the files and the pictures of the plain one in DIR, and prints a table.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from gsjax.cli import run_guarded


def compare(run: str, out: Path, *, views: int) -> None:
    """Writes the files, draws the first held-out views of each, prints the table."""
    from gsjax.colors import to_bytes
    from gsjax.io.gaussian_files import FORMATS, format_of
    from gsjax.io.images import write_image
    from gsjax.pipeline import convert
    from gsjax.render import gallery
    from gsjax.runs.result import open_result

    result = open_result(run)
    cameras = [c for c, held_out in zip(result.cameras, result.held_out, strict=True) if held_out][:views]
    plain = list(gallery.pictures(result.gaussians, cameras, result.background))
    for index, picture in enumerate(plain):
        write_image(out / f"plain_{index}.png", to_bytes(picture.colors))
    names = ["gaussians" + suffix for suffix in sorted(FORMATS, key=len)] + ["degree_0.spz"]
    print("| File | MB | Bytes a Gaussian | Clipped | PSNR, dB |", "|---|---|---|---|---|", sep="\n")
    for name in names:
        report = convert(run, out / name, sh_degree=0 if name.startswith("degree_0") else None)
        drawn = gallery.pictures(format_of(out / name).read(out / name), cameras, result.background)
        errors = [np.mean((a.colors - b.colors) ** 2) for a, b in zip(drawn, plain, strict=True)]
        psnr = ", ".join(f"{-10 * np.log10(e):.1f}" if e > 0 else "same" for e in errors)
        each = report["bytes"] / report["gaussians"]
        print(f"| {name} | {report['bytes'] / 1e6:.2f} | {each:.1f} | {report['clipped']} | {psnr} |", flush=True)


def main() -> None:
    """Reads the arguments and prints the table."""
    # A script beside this one has the name of the package.
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", metavar="RUN")
    parser.add_argument("--out", type=Path, required=True, help="folder for the files and pictures")
    parser.add_argument("--views", type=int, default=3, help="held-out views to compare")
    given = parser.parse_args()
    compare(given.run, given.out, views=given.views)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
