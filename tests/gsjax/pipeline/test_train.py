import importlib
from dataclasses import replace

import numpy as np
import pytest
from photographed_wall import wall

from gsjax.errors import InputError
from gsjax.scene import with_pixels

train = importlib.import_module("gsjax.pipeline.train")  # The package's attribute of that name is the function.


def test_masks_that_leave_nothing_are_refused():
    scene = wall(3)
    bare = [with_pixels(f, f.pixels()._replace(valid=np.zeros((f.height, f.width), np.uint8))) for f in scene.frames]
    train._require_pixels(replace(scene, frames=(*bare[:2], scene.frames[2])))
    with pytest.raises(InputError, match="wall: its masks leave no pixel of any photo"):
        train._require_pixels(replace(scene, frames=tuple(bare)))
