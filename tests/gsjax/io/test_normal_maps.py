from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from gsjax.errors import InputError
from gsjax.io import normal_folders
from gsjax.io.normal_maps import map_places, normal_maps
from gsjax.io.scenes import load_scene
from gsjax.scene import Pixels, frame_of

NAME = "001.png"


def frames(*names, width=12, height=8):
    K, viewmat = np.eye(3, dtype=np.float32), np.eye(4, dtype=np.float32)
    return tuple(
        frame_of(name, viewmat, K, Pixels(np.zeros((height, width, 3), np.uint8))) for name in names or (NAME,)
    )


def load_normals(folder, frames):
    """All maps, each read on its own."""
    return {name: read() for name, read in normal_maps(folder, frames).items()}


def smooth_normals(width=12, height=8):
    """The front of a sphere, `[H, W, 3]` float32."""
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, width), np.linspace(-0.5, 0.5, height))
    return np.stack([x, y, -np.sqrt(1 - x * x - y * y)], -1).astype(np.float32)


def write_png(path, normals, dtype):
    top = np.iinfo(dtype).max
    cv2.imwrite(str(path), np.rint((normals[..., ::-1] + 1) / 2 * top).astype(dtype))


@pytest.mark.parametrize("kind", ["npy", "npy-channels-first", "npz-cam", "npz-only", "png8", "png16"])
def test_every_format_gives_the_same_map(tmp_path, kind):
    normals = smooth_normals()
    write, tolerance = {
        "npy": (lambda path: np.save(path, 2.5 * normals.astype(np.float64)), 1e-6),  # length is not trusted
        "npy-channels-first": (lambda path: np.save(path, normals.transpose(2, 0, 1)), 1e-6),
        "npz-cam": (lambda path: np.savez(path, cam=normals, world=-normals), 1e-6),
        "npz-only": (lambda path: np.savez(path, whatever=normals.astype(np.float16)), 1e-3),
        "png8": (lambda path: write_png(path, normals, np.uint8), 8e-3),
        "png16": (lambda path: write_png(path, normals, np.uint16), 4e-5),
    }[kind]
    write(tmp_path / f"001.{kind[:3]}")
    loaded = load_normals(tmp_path, frames())[NAME]
    assert loaded.dtype == np.float32
    np.testing.assert_allclose(loaded, normals, atol=tolerance)
    np.testing.assert_allclose(np.linalg.norm(loaded, axis=-1), 1, atol=1e-6)


@pytest.mark.parametrize(("width", "level"), [(24, None), (12, 0), (6, 127), (12, 255)])
def test_nothing_stays_exactly_nothing(tmp_path, width, level):
    """Zeros of an array, and black, grey or white pixels."""
    normals = smooth_normals(width, width * 2 // 3)
    normals[:, : width // 2] = 0
    if level is None:
        np.save(tmp_path / "001.npy", normals)
    else:
        write_png(tmp_path / "001.png", normals, np.uint8)
        pixels = cv2.imread(str(tmp_path / "001.png"))
        pixels[:, : width // 2] = level
        cv2.imwrite(str(tmp_path / "001.png"), pixels)
    loaded = load_normals(tmp_path, frames())[NAME]
    assert (loaded[:, :6] == 0).all()
    np.testing.assert_allclose(np.linalg.norm(loaded[:, 6:], axis=-1), 1, atol=1e-6)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (b"\x93NUMPY damaged", "cannot be read"),
        (np.full((8, 12, 3), np.nan, np.float32), "finite"),
        (np.zeros((8, 12, 4)), "shape [8, 12, 4], not [H, W, 3]"),
        (np.zeros((12, 8, 3)), "normal map is 8x12, its frame 12x8"),
    ],
)
def test_a_map_that_cannot_be_used_is_left_out_and_named(tmp_path, capsys, bad, message):
    for name in ("a", "c"):
        np.save(tmp_path / f"{name}.npy", smooth_normals())
    if isinstance(bad, bytes):
        (tmp_path / "b.npy").write_bytes(bad)
    else:
        np.save(tmp_path / "b.npy", bad)
    loaded = load_normals(tmp_path, frames("a.png", "b.png", "c.png"))
    assert loaded["a.png"].any(-1).all() and loaded["c.png"].any(-1).all()
    assert loaded["b.png"].shape == (8, 12, 3) and not loaded["b.png"].any()
    (line,) = capsys.readouterr().err.splitlines()
    assert "b." in line and message in line and line.endswith("; 1 of 3 normal maps is left out")


def test_more_than_half_of_the_maps_must_be_usable(tmp_path):
    np.save(tmp_path / "0.npy", smooth_normals())
    needed = r": no normal map of 1.png; 6 of 7 normal maps cannot be used, and 4 are needed: 1.png, 2.png"
    with pytest.raises(InputError, match=needed):
        load_normals(tmp_path, frames(*[f"{i}.png" for i in range(7)]))
    with pytest.raises(InputError, match="no such folder of normal maps"):
        load_normals(tmp_path / "nowhere", frames())


# A wide lens that bends much, and the photo's size: with a positive coefficient the undistorted frame loses its
# border, with a negative one it keeps the photo's size.
CROPPED, WHOLE = (120.0, 78.0, 61.5, 0.12), (120.0, 78.0, 61.5, -0.12)
PHOTO = (160, 120)


def seen_along(rays):
    """A smooth field of normals over the directions in a camera's frame, unit."""
    x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    normals = np.stack([0.7 * np.sin(3 * x), 0.7 * np.cos(2 * y + x), -np.ones_like(x)], -1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def map_of_photo(params, size=PHOTO):
    """The field as the distorted photo records it, by pycolmap's inverse of the lens, at any size."""
    camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=PHOTO[0], height=PHOTO[1], params=list(params))
    x, y = ((np.arange(side) + 0.5) * full / side for side, full in zip(size, PHOTO, strict=True))
    pixels = np.stack(np.meshgrid(x, y), -1)
    rays = np.asarray(camera.cam_from_img(pixels.reshape(-1, 2))).reshape(*size[::-1], 2)
    return seen_along(np.dstack([rays, np.ones(size[::-1])])).astype(np.float32)


def map_of_frame(frame, size=None):
    """The field as the undistorted frame shows it."""
    width, height = (frame.width, frame.height) if size is None else size
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    rays = np.stack([x * frame.width, y * frame.height, np.ones_like(x)], -1) @ np.linalg.inv(frame.K.astype(float)).T
    return seen_along(rays).astype(np.float32)


def degrees(a, b):
    return np.degrees(np.arccos(np.clip((a.astype(float) * b).sum(-1), -1, 1)))


@pytest.fixture
def distorted(colmap_scene, tmp_path):
    """Frames of photos through a lens; and a function that reads the first one's map, given as an array."""

    def make(params, downscale=1):
        root = colmap_scene(count=2, model="SIMPLE_RADIAL", params=params, size=PHOTO)
        frames = load_scene(root, downscale=downscale).frames[:1]

        def read(array):
            np.save(tmp_path / "000.npy", array)
            return normal_maps(tmp_path, frames)["000.png"]()

        return frames[0], read

    return make


@pytest.mark.parametrize(("params", "downscale", "factor"), [(CROPPED, 1, 2), (CROPPED, 3, 1), (WHOLE, 1, 1)])
def test_maps_of_a_distorted_photo_are_undistorted_with_it(distorted, params, downscale, factor):
    frame, read = distorted(params, downscale)
    assert (frame.origin.undistorted == PHOTO) == (params is WHOLE)
    loaded = read(map_of_photo(params, (PHOTO[0] // factor, PHOTO[1] // factor)))
    assert loaded.shape == (frame.height, frame.width, 3)
    np.testing.assert_allclose(np.linalg.norm(loaded, axis=-1), 1, atol=1e-6)
    error = degrees(loaded, map_of_frame(frame))
    assert error[2:-2, 2:-2].max() < 0.2, "borders are read from the map's last pixels"
    as_it_is = cv2.resize(map_of_photo(params), (frame.width, frame.height), interpolation=cv2.INTER_AREA)
    assert degrees(as_it_is / np.linalg.norm(as_it_is, axis=-1, keepdims=True), map_of_frame(frame)).max() > 1.5


@pytest.mark.parametrize(("downscale", "factor"), [(1, 2), (3, 1)])
def test_maps_of_the_undistorted_frame_are_taken_as_they_are(distorted, downscale, factor):
    frame, read = distorted(CROPPED, downscale)
    width, height = frame.origin.undistorted
    loaded = read(map_of_frame(frame, (round(width / factor), round(height / factor))))
    assert degrees(loaded, map_of_frame(frame)).max() < 0.25 * downscale * factor
    np.testing.assert_allclose(read(map_of_frame(frame)), map_of_frame(frame), atol=1e-6)


@pytest.mark.parametrize("downscale", [1, 3])
def test_what_a_distorted_map_does_not_know_does_not_bleed(distorted, downscale):
    frame, read = distorted(CROPPED, downscale)
    normals = map_of_photo(CROPPED)
    unknown = np.zeros(PHOTO[::-1], bool)
    unknown[40:70, 60:90] = True
    normals[unknown] = 0
    loaded = read(normals)
    none = ~loaded.any(axis=-1)
    np.testing.assert_allclose(np.linalg.norm(loaded[~none], axis=-1), 1, atol=1e-6)
    # Beside the hole a direction comes from the known side of its neighbours: at most two pixels of the photo away.
    assert degrees(loaded, map_of_frame(frame))[~none].max() < 2.5 * downscale
    positions = frame.origin.positions() * PHOTO
    inside = (positions[..., 0] > 60) & (positions[..., 0] < 90) & (positions[..., 1] > 40) & (positions[..., 1] < 70)
    assert (none != inside).mean() < 0.01 * downscale and none.sum() > 50 / downscale


def test_distorted_maps_whose_size_does_not_tell_what_they_show_are_refused(distorted):
    frame, read = distorted(CROPPED)
    (width, height), size = frame.origin.undistorted, (100, 75)
    assert abs(width / height - 4 / 3) < 0.03, "else the sizes would tell"
    undistorted = f"its undistorted frame's, {width}x{height}; `gsjax undistort` makes"
    with pytest.raises(InputError, match=f"100x75, may be its photo's, 160x120, or {undistorted}"):
        read(np.zeros((*size[::-1], 3), np.float32))
    with pytest.raises(InputError, match="100x100, neither its photo's, 160x120, nor its undistorted frame's"):
        read(np.zeros((100, 100, 3), np.float32))


def test_maps_are_found_where_they_were_placed(tmp_path):
    views = frames("../photos/a.png", "left/b.jpg", "left/b.png")
    manifest = normal_folders.begin(tmp_path, {"network": "n"})
    for index, (name, place) in enumerate(map_places(views).items()):
        normals = np.roll(smooth_normals(), index, axis=1)
        normal_folders.add(tmp_path, manifest, name, Path(f"{place}.npz"), normals, {})
    for index, frame in enumerate(views):
        # One at a time: whatever the others are called, each finds its own.
        loaded = load_normals(tmp_path, (frame,))[frame.name]
        np.testing.assert_allclose(loaded, np.roll(smooth_normals(), index, axis=1), atol=1e-3)
        assert degrees(loaded, np.roll(smooth_normals(), index, axis=1)).max() < 0.03, "half precision"
    (tmp_path / "normals.json").write_text('{"maps": {}}')
    with pytest.raises(InputError, match="normals.json: lacks .made_by."):
        normal_folders.network_of(tmp_path)
