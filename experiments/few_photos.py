"""What would be left of a data set if few photos had been taken? Writes such a one, the others held out.

    python experiments/few_photos.py SCENE OUT --photos N [--held-out M]

N photos are trained on: one near the middle, then each time the one that is farthest from all chosen ones, by place and
direction. The rest, or M of them spread evenly by name, is held out (`OUT/hold_out.txt`). The COLMAP model keeps the
cameras, and only such points as two of the N photos have in common. OUT/images links to the photos of SCENE.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from gsjax.cli import run_guarded
from gsjax.cli.parsers import count
from gsjax.io.files import make_folder


def farthest(features: np.ndarray, number: int) -> list[int]:
    """Rows of `[P, D]` features: the one nearest to the mean, then always the farthest from all chosen ones."""
    chosen = [int(np.argmin(np.linalg.norm(features - features.mean(0), axis=1)))]
    while len(chosen) < number:
        nearest = np.linalg.norm(features[:, None] - features[chosen], axis=-1).min(axis=1)
        chosen.append(int(nearest.argmax()))
    return chosen


def write_few(scene: Path, out: Path, number: int, held_out: int | None) -> str:
    """Writes the data set; returns a line that says what is in it."""
    import pycolmap

    model = pycolmap.Reconstruction(scene / "sparse/0")
    images = sorted(model.images.values(), key=lambda image: image.name)
    places = np.stack([image.projection_center() for image in images])
    places /= np.linalg.norm(places - places.mean(0), axis=1).mean()
    directions = np.stack([image.viewing_direction() for image in images])
    chosen = set(farthest(np.concatenate([places, directions], axis=1), min(number, len(images))))
    rest = [image for index, image in enumerate(images) if index not in chosen]
    spread = np.unique(np.linspace(0, len(rest) - 1, held_out or len(rest)).round().astype(int)) if rest else ()
    kept = [rest[index] for index in spread]
    for image in rest:
        for index, point in enumerate(image.points2D):
            if point.has_point3D():
                model.delete_observation(image.image_id, index)
    for point_id, point in list(model.points3D.items()):
        if point.track.length() < 2:
            model.delete_point3D(point_id)
    for image in rest:
        if image not in kept:
            model.deregister_frame(image.frame_id)
    folder = make_folder(out / "sparse/0")
    (out / "images").symlink_to((scene / "images").resolve())
    model.write_binary(folder)
    (out / "hold_out.txt").write_text("".join(f"{image.name}\n" for image in kept), encoding="utf-8")
    return f"{len(chosen)} photos to train on, {len(kept)} held out, {model.num_points3D():,} points"


def main() -> None:
    """Reads the arguments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", metavar="SCENE", type=Path, help="data set with a COLMAP model, SCENE/sparse/0")
    parser.add_argument("out", metavar="OUT", type=Path, help="folder that does not exist yet")
    parser.add_argument("--photos", type=count, required=True, metavar="N", help="that are trained on")
    parser.add_argument("--held-out", type=count, metavar="M", help="that are scored (default: all others)")
    arguments = parser.parse_args()
    print(write_few(arguments.scene, arguments.out, arguments.photos, arguments.held_out))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
