"""A data set written as training reads it, for networks and programs that require pinhole photos."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io.colmap_writer import write_model
from gsjax.io.files import atomic_folder, require_empty
from gsjax.io.georeference_files import write_place
from gsjax.io.images import write_image
from gsjax.io.photo_names import written_name
from gsjax.io.scenes import load_scene
from gsjax.io.splits import OWN_LIST
from gsjax.scene import Frame


def undistort(
    scene: str | Path, out: str | Path, *, downscale: float = 1.0, images: str | None = None
) -> dict[str, Any]:
    """Write the frames that training sees: undistorted, cropped, masked, downscaled.

    Args:
        scene: Folder of the data set, see `gsjax.io.scenes.load_scene`.
        out: Folder to make, absent or empty; appears when everything is done. It is a data set with the same views,
            split and points: `images/` (JPEG at quality 95 where the photo is one or HEIC, else PNG; with the matte as
            alpha), `masks/` where not every pixel is valid, `sparse/0` with PINHOLE cameras, `hold_out.txt`.
        downscale: Frames are this many times smaller, at least 1.
        images: Folder of the photos, absolute or in `scene`. None: searched for.

    Returns:
        `images`, `held_out`, `masks`: how many; `points`.

    Raises:
        InputError: The data set cannot be used, two frames would be written to one file, or `out` is in use or cannot
            be written.
    """
    require_empty(out)
    loaded = load_scene(scene, downscale=downscale, images=images)
    frames_by_name: dict[str, Frame] = {}
    masks = 0
    with atomic_folder(out) as folder:
        for frame in tqdm(loaded.frames, desc="undistort", unit="image"):
            pixels = frame.pixels()
            name = written_name(frame.name, pixels.matte is not None)
            if name in frames_by_name:
                raise InputError(f"{scene}: two of its photos would both be written as {name}")
            frames_by_name[name] = replace(frame, name=name)
            picture = pixels.image if pixels.matte is None else np.dstack([pixels.image, pixels.matte])
            write_image(folder / "images" / name, picture)
            if pixels.valid is not None and not pixels.valid.all():
                write_image(folder / "masks" / f"{name}.png", pixels.valid)
                masks += 1
        held_out = [name for name, frame in frames_by_name.items() if frame.held_out]
        (folder / OWN_LIST).write_text("".join(f"{name}\n" for name in held_out), encoding="utf-8")
        frames = tuple(frames_by_name.values())
        write_model(folder / "sparse" / "0", frames, loaded.points, loaded.point_colors, loaded.similarity)
        write_place(folder, loaded.place.reached)
    return {"images": len(frames_by_name), "held_out": len(held_out), "masks": masks, "points": len(loaded.points)}
