import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.io.truth import load_truth
from gsjax.scene import Pixels, frame_of


def frame(name="a/001.png", width=6, height=4):
    image = np.zeros((height, width, 3), np.uint8)
    return frame_of(name, np.eye(4, dtype=np.float32), np.eye(3, dtype=np.float32), Pixels(image))


def test_maps_are_read_at_the_nearest_pixel_centre_and_normals_become_unit(tmp_path):
    (tmp_path / "depth/a").mkdir(parents=True)
    depth = np.arange(24, dtype=np.float32).reshape(4, 6)
    np.savez(tmp_path / "depth/a/001.npz", depth=depth, label=depth.astype(np.uint8))
    whole = load_truth(tmp_path, (frame(),))
    np.testing.assert_array_equal(whole.depths["a/001.png"](), depth)
    np.testing.assert_array_equal(whole.labels["a/001.png"](), depth.astype(np.uint8))
    half = load_truth(tmp_path, (frame(width=3, height=2),))
    np.testing.assert_array_equal(half.depths["a/001.png"](), depth[1::2, 1::2])
    assert not whole.normals and whole.points is None
    (tmp_path / "normals/a").mkdir(parents=True)
    cam = np.zeros((4, 6, 3), np.float16)
    cam[1:] = (0.3, 0.0, -0.4)
    np.savez(tmp_path / "normals/a/001.npz", cam=cam, world=cam)
    normals = load_truth(tmp_path, (frame(),)).normals["a/001.png"]()
    assert normals.dtype == np.float32 and not normals[0].any()
    np.testing.assert_allclose(normals[1:], np.broadcast_to([0.6, 0, -0.8], (3, 6, 3)), atol=3e-4)


def test_faults_are_named(tmp_path):
    (tmp_path / "depth/a").mkdir(parents=True)
    file = tmp_path / "depth/a/001.npz"
    np.savez(file, depth=np.zeros((4, 6), np.float32))
    with pytest.raises(InputError, match=r"001.npz: lacks label; it holds depth"):
        load_truth(tmp_path, (frame(),))
    np.savez(file, depth=np.zeros((4, 12), np.float32), label=np.zeros((4, 12), np.uint8))
    with pytest.raises(InputError, match=r"001.npz: map is 12x4 but a/001.png is 6x4"):
        load_truth(tmp_path, (frame(),))
    file.write_bytes(file.read_bytes()[:-20])
    with pytest.raises(InputError, match=r"001.npz: cannot be read"):
        load_truth(tmp_path, (frame(),))
