"""Masks of the sky that come with the photos."""

from gsjax.effects.sky import Masks
from gsjax.errors import InputError
from gsjax.io.scenes import load_scene
from gsjax.scene import Scene, valid_pixels
from gsjax.settings import AUTO, NONE, Settings


def read_sky_masks(scene: Scene, settings: Settings, downscale: float) -> Masks | None:
    """Where the masks that the settings name say that the photos show sky; None where they name none.

    Args:
        scene: As it is trained on.
        settings: The run.
        downscale: How many times smaller its photos are than they were taken.

    Raises:
        InputError: There is no such folder, it has no mask of any photo, or one does not fit its photo.
    """
    if settings.effects.sky in (None, AUTO):
        return None
    folder = scene.root / settings.effects.sky  # An absolute path stays what it is.
    if not folder.is_dir():
        raise InputError(f"--sky {settings.effects.sky}: there is no such folder, in {scene.root} or elsewhere")
    masked = load_scene(
        scene.root,
        downscale=downscale,
        images=settings.photos.images,
        hold_out=NONE,
        similarity=scene.similarity,
        place=scene.place,
        masks=folder,
    )
    shown = {frame.name: valid_pixels(frame) for frame in masked.frames if frame.masked}
    masks = {}
    for frame in scene.frames:
        usable, sky = valid_pixels(frame), shown.get(frame.name)
        is_sky = None if sky is None else ~sky if usable is None else ~sky & usable
        if is_sky is not None and is_sky.any():
            masks[frame.name] = is_sky
    if not masks:
        raise InputError(f"--sky {settings.effects.sky}: no mask in {folder} is 0 anywhere where a photo may be used")
    return masks
