"""Measured depth: what files hold, in their unit, at the pixels of a frame."""

import json

import numpy as np
import pytest
from PIL import Image

from gsjax.errors import InputError
from gsjax.io.depth_maps import open_depth_maps
from gsjax.io.depth_windows import on_grid
from gsjax.scene import Pixels, frame_of

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


def test_arkits_levels_are_nothing_half_and_all(tmp_path):
    write_png(tmp_path / "depth/a.png", RAMP)
    write_png(tmp_path / "confidence/a.png", (np.arange(WIDTH * HEIGHT) % 3).reshape(HEIGHT, WIDTH).astype(np.uint8))
    _, trust = opened(tmp_path).read["a.jpg"]()
    np.testing.assert_array_equal(trust.reshape(-1)[:6], [0, 127, 255] * 2)


def test_zero_and_what_is_not_finite_is_unknown_without_confidence(tmp_path):
    values = RAMP.astype(np.float64)
    values[0, :5] = 0, np.nan, np.inf, -3, 1e300
    (tmp_path / "depth").mkdir()
    np.save(tmp_path / "depth/a.npy", values)
    depth, trust = opened(tmp_path).read["a.jpg"]()
    assert not depth[0, :5].any() and not trust[0, :5].any()
    np.testing.assert_array_equal(depth[1:], RAMP[1:])
    assert depth.dtype == np.float32 and (trust[1:] == 255).all()


@pytest.mark.parametrize("scale", [1, 2, 3])
def test_a_larger_map_gives_every_pixel_the_value_at_its_centre(scale):
    fine = np.arange(24 * 36, dtype=np.float32).reshape(24, 36) + 1  # three to a pixel
    depth, _ = on_grid((fine, np.full(fine.shape, 255, np.uint8)), FRAMES[0], scale)
    rows, columns = ((np.arange(side // scale) + 0.5) * scale for side in (HEIGHT, WIDTH))
    expected = fine[(3 * rows[:, None]).astype(int), (3 * columns).astype(int)]
    np.testing.assert_array_equal(depth, expected)


def test_of_a_smaller_map_each_value_goes_to_the_pixel_that_holds_it_and_nowhere_else():
    coarse = np.arange(1, 7, dtype=np.float32).reshape(2, 3)  # four to a value
    depth, trust = on_grid((coarse, np.full((2, 3), 9, np.uint8)), FRAMES[0], 1)
    expected = np.zeros((HEIGHT, WIDTH), np.float32)
    expected[2::4, 2::4] = coarse
    np.testing.assert_array_equal(depth, expected)
    np.testing.assert_array_equal(trust, 9 * (expected > 0))
    np.testing.assert_array_equal(on_grid((coarse, trust[2::4, 2::4]), FRAMES[0], 4)[0], coarse)


def faulty(tmp_path, fault):
    folder = tmp_path / "depth"
    if fault == "no folder":
        return
    write_png(folder / "a.png", RAMP if fault != "8 bits" else RAMP.astype(np.uint8))
    if fault == "size":
        write_png(folder / "a.png", RAMP[:, :5])
    elif fault == "no map":
        (folder / "a.png").rename(folder / "z.png")
    elif fault == "unknown unit":
        (folder / "depth.json").write_text('{"unit": "inch"}')
    elif fault == "confidence":
        write_png(tmp_path / "confidence/a.png", np.zeros((HEIGHT // 2, WIDTH // 2), np.uint8))
    elif fault == "array":
        (folder / "a.png").unlink()
        np.save(folder / "a.npy", np.zeros((HEIGHT, WIDTH, 3), np.float32))
    elif fault == "truncated":
        (folder / "a.png").write_bytes((folder / "a.png").read_bytes()[:60])


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("no folder", "--depth depth: no such folder of depth maps, in .* or here"),
        ("8 bits", "depth/a.png: a picture of 8 bits; a depth map has 16"),
        ("size", "depth/a.png: depth map is 5x8, its photo 12x8; one of them is turned"),
        ("no map", "depth: no depth map in it has the name of a photo, as a.png"),
        ("no unit", "depth: the unit of its depth is not stated; --depth-unit mm, or depth.json in it"),
        ("unknown unit", "depth/depth.json: unit"),
        ("confidence", "confidence/a.png: confidence is 6x4 of uint8, its depth map 12x8"),
        ("array", r"depth/a.npy: an array of shape \[8, 12, 3\] and type float32, not a depth map"),
        ("truncated", "depth/a.png: not a whole picture of one channel"),
    ],
)
def test_what_cannot_serve_is_one_line(tmp_path, fault, message, capfd):
    faulty(tmp_path, fault)
    with pytest.raises(InputError, match=message) as caught:
        opened(tmp_path, None if "unit" in fault else "mm").read["a.jpg"]()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("fault", ["8 bits", "size", "confidence", "truncated"])
def test_one_map_that_cannot_serve_is_left_out_and_named(tmp_path, fault, capfd):
    write_png(tmp_path / "depth/b.png", RAMP)
    faulty(tmp_path, fault)
    assert list(opened(tmp_path).read) == ["b.jpg"]
    message = capfd.readouterr().err
    assert message.count("\n") == 1 and "; 1 of 2 depth maps is left out" in message
