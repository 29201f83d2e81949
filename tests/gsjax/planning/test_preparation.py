from dataclasses import replace

import numpy as np
import pytest
from photographed_wall import wall

from gsjax.errors import InputError
from gsjax.planning.preparation import read_photos
from gsjax.scene import in_memory, with_pixels


def test_masks_that_leave_nothing_are_refused():
    scene = wall(3)
    bare = [with_pixels(f, f.pixels()._replace(valid=np.zeros((f.height, f.width), np.uint8))) for f in scene.frames]
    assert len(read_photos(replace(scene, frames=(*bare[:2], scene.frames[2])), in_memory).frames) == 3
    with pytest.raises(InputError, match="wall: its masks leave no pixel of any photo"):
        read_photos(replace(scene, frames=tuple(bare)), in_memory)
