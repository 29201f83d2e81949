"""Measured depth: what files hold, in their unit, at the pixels of a frame of the same or another shape."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image
from transforms_ring import edit, write

from gsjax.errors import InputError
from gsjax.io.depth_maps import open_depth_maps
from gsjax.io.depth_windows import Window, on_grid, window_of
from gsjax.io.scenes import load_scene
from gsjax.planning.depth_supervision import measured_depth
from gsjax.scene import Pixels, frame_of
from gsjax.settings import Supervision

WIDTH, HEIGHT = 12, 8
FRAMES = tuple(
    frame_of(f"{name}.jpg", np.eye(4, dtype=np.float32), np.eye(3, dtype=np.float32),
             Pixels(np.zeros((HEIGHT, WIDTH, 3), np.uint8)))
    for name in "ab"
)  # fmt: skip
RAMP = (1000 + np.arange(WIDTH * HEIGHT)).reshape(HEIGHT, WIDTH).astype(np.uint16)  # of millimetres


def write_png(file, values):
    file.parent.mkdir(exist_ok=True, parents=True)
    Image.fromarray(values).save(file)
    return file


def opened(scene, unit="mm", frames=FRAMES):
    return open_depth_maps(scene, "depth", unit, frames)


def test_pngs_and_arrays_are_read_in_their_unit_with_their_confidence(tmp_path):
    write_png(tmp_path / "depth/a.png", RAMP)
    np.save(tmp_path / "depth/b.npy", RAMP.astype(np.float64))
    (tmp_path / "depth/depth.json").write_text(json.dumps({"unit": "cm"}))
    levels = np.full((HEIGHT, WIDTH), 200, np.uint8)
    levels[0] = 10
    write_png(tmp_path / "confidence/b.png", levels)
    maps = opened(tmp_path, None)
    assert (maps.unit, opened(tmp_path).unit, sorted(maps.read)) == ("cm", "mm", ["a.jpg", "b.jpg"])
    depth, trust = maps.read["a.jpg"]()
    np.testing.assert_array_equal(depth, RAMP)
    np.testing.assert_array_equal(trust, 255)
    depth, trust = maps.read["b.jpg"]()
    np.testing.assert_array_equal(depth, RAMP)
    np.testing.assert_array_equal(trust, levels)
    # ARKit's levels are nothing, half and all.
    write_png(tmp_path / "confidence/b.png", (np.arange(WIDTH * HEIGHT) % 3).reshape(HEIGHT, WIDTH).astype(np.uint8))
    np.testing.assert_array_equal(opened(tmp_path).read["b.jpg"]()[1].reshape(-1)[:6], [0, 127, 255] * 2)


def test_zero_and_what_is_not_finite_is_unknown_without_confidence(tmp_path):
    values = RAMP.astype(np.float64)
    values[0, :5] = 0, np.nan, np.inf, -3, 1e300
    (tmp_path / "depth").mkdir()
    np.save(tmp_path / "depth/a.npy", values)
    depth, trust = opened(tmp_path).read["a.jpg"]()
    assert not depth[0, :5].any() and not trust[0, :5].any()
    np.testing.assert_array_equal(depth[1:], RAMP[1:])
    assert depth.dtype == np.float32 and (trust[1:] == 255).all()


def test_of_a_smaller_map_each_value_goes_to_the_pixel_that_holds_it_and_nowhere_else():
    coarse = np.arange(1, 7, dtype=np.float32).reshape(2, 3)  # four to a value
    depth, trust = on_grid((coarse, np.full((2, 3), 9, np.uint8)), FRAMES[0], 1, Window(0, 0, 3, 2))
    expected = np.zeros((HEIGHT, WIDTH), np.float32)
    expected[2::4, 2::4] = coarse
    np.testing.assert_array_equal(depth, expected)
    np.testing.assert_array_equal(trust, 9 * (expected > 0))
    np.testing.assert_array_equal(on_grid((coarse, trust[2::4, 2::4]), FRAMES[0], 4, Window(0, 0, 3, 2))[0], coarse)


def write_array(file):
    file.unlink()
    np.save(file.with_suffix(".npy"), np.zeros((HEIGHT, WIDTH, 3), np.float32))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda file: shutil.rmtree(file.parent), "depth=depth: no such folder of depth maps, in .* or here"),
        (lambda file: write_png(file, RAMP.astype(np.uint8)), "depth/a.png: a picture of 8 bits; a depth map has 16"),
        (lambda file: write_png(file, RAMP[:, :5]), "a.png: depth map is 5x8, its photo 12x8; one of them is turned"),
        (lambda file: file.rename(f"{file}.png"), "depth: no depth map in it has the name of a photo, as a.png"),
        (lambda file: None, "depth: its unit of depth is not stated; set supervision.depth_unit, or"),
        (write_array, r"depth/a.npy: an array of shape \[8, 12, 3\] and type float32, not a depth map"),
        (lambda file: file.write_bytes(file.read_bytes()[:60]), "depth/a.png: not a whole picture of one channel"),
    ],
)
def test_what_cannot_serve_is_one_line(tmp_path, damage, message, capfd):
    file = write_png(tmp_path / "depth/a.png", RAMP)
    damage(file)
    with pytest.raises(InputError, match=message) as caught:
        opened(tmp_path, None if "unit" in message else "mm").read["a.jpg"]()
    assert "\n" not in str(caught.value)
    capfd.readouterr()
    if file.exists() and "unit" not in message:  # One map of two is left out.
        write_png(tmp_path / "depth/b.png", RAMP)
        assert list(opened(tmp_path).read) == ["b.jpg"]
        line, end = capfd.readouterr().err.split("\n")
        assert "; 1 of 2 depth maps is left out" in line and not end


def frame(width, height, focal=100.0, center=None):
    cx, cy = center or (width / 2, height / 2)
    K = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]], np.float32)
    return frame_of("a.png", np.eye(4, dtype=np.float32), K, Pixels(np.zeros((height, width, 3), np.uint8)))


def whole(values):
    return values, np.full(values.shape, 255, np.uint8)


def plane_depth(x, y):
    """Depth by the ray, x/z and y/z: unlike in all directions."""
    return (2 + 0.9 * x - 0.5 * y).astype(np.float32)


def rays(width, height, fx, fy, cx, cy):
    return (np.arange(width) + 0.5 - cx) / fx, ((np.arange(height) + 0.5 - cy) / fy)[:, None]


@pytest.mark.parametrize(
    ("size", "photo", "part"),
    [
        ((224, 172), (960, 540), (224, 126)),  # 3RScan
        ((640, 576), (2048, 1536), (640, 480)),  # Azure Kinect
    ],
)
def test_of_a_map_of_another_shape_the_middle_shows_the_photo(tmp_path, size, photo, part):
    """The map has square pixels and the photo's axis in its middle; it shows more above and below, or at the sides."""
    focal = 0.8 * part[0]  # both see as much across their common part
    depth = plane_depth(*rays(*size, focal, focal, size[0] / 2, size[1] / 2))
    small = frame(photo[0] // 2, photo[1] // 2, 0.8 * (photo[0] // 2))
    window, note = window_of(tmp_path / "a.png", size, small, None)
    assert note.startswith(f"of maps of {size[0]}x{size[1]} the middle {part[0]}x")
    photo_depth, trust = on_grid(whole(depth), small, 1, window)
    K = small.K.astype(float)
    expected = plane_depth(*rays(small.width, small.height, K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    is_measured = photo_depth > 0
    np.testing.assert_array_equal(trust, 255 * is_measured)
    assert is_measured.sum() >= 0.95 * min(photo_depth.size, part[0] * part[1]), "all of the photo is covered"
    # A value is at most half a pixel, of the map or of the frame, away from the ray that it was measured on.
    assert np.abs(photo_depth - expected)[is_measured].max() < (0.9 + 0.5) * 0.5 / min(focal, K[0, 0]) + 1e-3


def test_intrinsics_place_a_map_where_its_camera_looked(tmp_path):
    """A sensor with a wider view, off the photo's axis, that misses the right edge of the photo."""
    photo = frame(60, 40, 70.0, (31.0, 19.0))
    fx, fy, cx, cy, size = 65.0, 60.0, 48.0, 30.0, (70, 64)
    depth = plane_depth(*rays(*size, fx, fy, cx, cy))
    (tmp_path / "depth").mkdir()
    np.save(tmp_path / "depth/a.npy", depth)
    K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    (tmp_path / "depth/depth.json").write_text(json.dumps({"unit": "m", "intrinsics": K}))
    maps = open_depth_maps(tmp_path, "depth", None, (photo,))
    assert maps.note == "maps of 70x64 are read with their own intrinsics"
    photo_depth, _ = maps.at(photo, 1)
    x, y = rays(60, 40, 70.0, 70.0, 31.0, 19.0)
    is_seen = np.broadcast_to((x * fx + cx < 70) & (y * fy + cy < 64), photo_depth.shape)
    assert 0.6 < is_seen.mean() < 1
    expected = np.broadcast_to(plane_depth(x, y), photo_depth.shape)
    assert np.abs(photo_depth - expected)[is_seen & (photo_depth > 0)].max() < 0.02
    assert (photo_depth[~is_seen] == 0).all() and (photo_depth[is_seen] > 0).mean() > 0.6


@pytest.fixture
def listed(tmp_path):
    """Writes photos of 40x30 whose transforms.json lists depth of 20x15, of 1,500 units each."""

    def make(**root):
        write(tmp_path, fl_x=50.0, w=40, h=30, **root)
        for n in range(8):
            write_png(tmp_path / f"lidar/{n:03d}.png", np.full((15, 20), 1500, np.uint16))
        edit(tmp_path, lambda m: [f.update(depth_file_path=f"lidar/{n:03d}.png") for n, f in enumerate(m["frames"])])
        return tmp_path

    return make


@pytest.mark.parametrize(
    ("root", "unit", "metres", "named"),
    [
        ({}, None, 1.5, "in mm"),
        ({"depth_unit_scale_factor": 1 / 256}, None, 1500 / 256, "in units of 0.00390625 m"),
        ({"depth_unit_scale_factor": 1 / 256}, "cm", 15.0, "in cm"),
    ],
)
def test_maps_that_transforms_lists_are_read_in_its_unit(listed, root, unit, metres, named):
    scene = load_scene(listed(**root), hold_out="none")
    measured = measured_depth(scene, Supervision(depth="auto", depth_unit=unit))
    assert measured is not None and f"of 8 of 8 photos, {named}; no points determine the scale" in measured.line
    for depth, trust in measured.depths(2):
        np.testing.assert_allclose(depth, scene.similarity.length_to_local(metres), rtol=1e-5)
        assert (trust == 255).all()


def test_listed_maps_that_cannot_serve_are_named(listed):
    root = listed()
    (root / "lidar/depth.json").write_text('{"intrinsics": [[0, 0, 1], [0, 1, 1], [0, 0, 1]]}')
    with pytest.raises(InputError, match="depth.json: intrinsics are no matrix"):
        measured_depth(load_scene(root, hold_out="none"), Supervision(depth="auto"))
    shutil.rmtree(root / "lidar")
    with pytest.raises(InputError, match="lidar/000.png: no such depth map"):
        measured_depth(load_scene(root, hold_out="none"), Supervision(depth="auto"))
