"""Masks of the sky that come with the photos."""

from gsjax.effects.sky import Masks
from gsjax.errors import InputError
from gsjax.io.scenes import load_scene
from gsjax.scene import Scene, valid_pixels
from gsjax.settings import AUTO, NONE


def read_sky_masks(scene: Scene, folder: str | None, images: str | None, downscale: float) -> Masks | None:
    """Where photos show sky, by the masks in a folder; None where no folder is named.

    `folder` is within the data set or absolute. The scene's photos are `downscale` times smaller than they were taken.

    Raises:
        InputError: There is no such folder, it has no mask of any photo, or one does not fit its photo.
    """
    if folder in (None, AUTO):
        return None
    source = scene.root / folder  # An absolute path stays what it is.
    if not source.is_dir():
        raise InputError(f"sky={folder}: there is no such folder, in {scene.root} or elsewhere")
    masked = load_scene(
        scene.root,
        downscale=downscale,
        images=images,
        hold_out=NONE,
        similarity=scene.similarity,
        place=scene.place,
        masks=source,
    )
    without_sky = {frame.name: valid_pixels(frame) for frame in masked.frames if frame.masked}
    masks = {}
    for frame in scene.frames:
        usable, sky = valid_pixels(frame), without_sky.get(frame.name)
        is_sky = None if sky is None else ~sky if usable is None else ~sky & usable
        if is_sky is not None and is_sky.any():
            masks[frame.name] = is_sky
    if not masks:
        raise InputError(f"sky={folder}: no mask in {source} is 0 anywhere where a photo may be used")
    return masks
