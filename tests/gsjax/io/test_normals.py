import cv2
import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.io.normals import normal_maps
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
    if kind == "npy":
        np.save(tmp_path / "001.npy", 2.5 * normals.astype(np.float64))  # length is not trusted
    elif kind == "npy-channels-first":
        np.save(tmp_path / "001.npy", normals.transpose(2, 0, 1))
    elif kind == "npz-cam":
        np.savez(tmp_path / "001.npz", cam=normals, world=-normals)
    elif kind == "npz-only":
        np.savez(tmp_path / "001.npz", whatever=normals.astype(np.float16))
    else:
        write_png(tmp_path / "001.png", normals, np.uint8 if kind == "png8" else np.uint16)
    loaded = load_normals(tmp_path, frames())[NAME]
    assert loaded.dtype == np.float32
    tolerance = {"png8": 8e-3, "npz-only": 1e-3, "png16": 4e-5}.get(kind, 1e-6)
    np.testing.assert_allclose(loaded, normals, atol=tolerance)
    np.testing.assert_allclose(np.linalg.norm(loaded, axis=-1), 1, atol=1e-6)


@pytest.mark.parametrize("size", [(24, 16), (6, 4), (25, 17)])
def test_maps_are_resized_and_stay_unit(tmp_path, size):
    np.save(tmp_path / "001.npy", smooth_normals(*size))
    loaded = load_normals(tmp_path, frames())[NAME]
    assert loaded.shape == (8, 12, 3)
    np.testing.assert_allclose(np.linalg.norm(loaded, axis=-1), 1, atol=1e-6)
    # Resized pixel centres lie up to a fifth of the frame inside the sphere's sampled range: compare directions.
    x, y = (np.arange(12) + 0.5) / 12, (np.arange(8) + 0.5) / 8
    sampled = cv2.remap(
        smooth_normals(*size),
        *[m.astype(np.float32) for m in np.meshgrid(x * size[0] - 0.5, y * size[1] - 0.5)],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    cosine = (sampled * loaded).sum(-1) / np.linalg.norm(sampled, axis=-1)
    assert cosine.min() > np.cos(np.radians(0.2))


@pytest.mark.parametrize("width", [6, 12, 24])
@pytest.mark.parametrize("png", [False, True])
def test_nothing_stays_exactly_nothing(tmp_path, width, png):
    normals = smooth_normals(width, width * 2 // 3)
    normals[:, : width // 2] = 0
    if png:
        write_png(tmp_path / "001.png", normals, np.uint8)
    else:
        np.save(tmp_path / "001.npy", normals)
    loaded = load_normals(tmp_path, frames())[NAME]
    assert (loaded[:, :6] == 0).all()
    np.testing.assert_allclose(np.linalg.norm(loaded[:, 6:], axis=-1), 1, atol=1e-6)


@pytest.mark.parametrize("level", [0, 127, 128, 255])
def test_grey_black_and_white_pixels_say_nothing(tmp_path, level):
    write_png(tmp_path / "001.png", smooth_normals(), np.uint8)
    pixels = cv2.imread(str(tmp_path / "001.png"))
    pixels[:4] = level
    cv2.imwrite(str(tmp_path / "001.png"), pixels)
    loaded = load_normals(tmp_path, frames())[NAME]
    assert (loaded[:4] == 0).all() and loaded[4:].any(axis=-1).all()


def test_frames_in_folders_have_their_own_maps(tmp_path):
    (tmp_path / "left").mkdir()
    (tmp_path / "right").mkdir()
    np.save(tmp_path / "left/001.npy", smooth_normals())
    np.save(tmp_path / "right/001.npy", -smooth_normals())
    np.save(tmp_path / "002.npy", smooth_normals())
    loaded = load_normals(tmp_path, frames("left/001.png", "right/001.png", "left/002.png"))
    np.testing.assert_allclose(loaded["left/001.png"], -loaded["right/001.png"])
    (tmp_path / "right/001.npy").rename(tmp_path / "001.npy")
    with pytest.raises(InputError, match=r"1 normal map missing: right/001.png"):
        load_normals(tmp_path, frames("left/001.png", "right/001.png"))  # 001.npy could be either's


def test_missing_maps_are_all_counted(tmp_path):
    with pytest.raises(InputError, match=r"7 normal maps missing: 0.png, 1.png, 2.png, 3.png, 4.png and 2 more"):
        load_normals(tmp_path, frames(*[f"{i}.png" for i in range(7)]))
    with pytest.raises(InputError, match="no such folder of normal maps"):
        load_normals(tmp_path / "nowhere", frames())


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_counted(tmp_path, value):
    normals = smooth_normals()
    normals[2, 3:6, 1] = value
    np.save(tmp_path / "001.npy", normals)
    with pytest.raises(InputError, match=r"001.npy: 3 pixels of the normal map are not finite"):
        load_normals(tmp_path, frames())


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((8, 12)), r"shape \[8, 12\], not \[H, W, 3\]"),
        (np.zeros((8, 12, 4)), r"shape \[8, 12, 4\]"),
        (np.zeros((12, 8, 3)), "normal map is 8x12, its frame 12x8"),
        (np.zeros((8, 12, 3), np.uint8), "of type uint8, not of floats"),
    ],
)
def test_maps_of_another_kind_are_refused(tmp_path, array, message):
    np.save(tmp_path / "001.npy", array)
    with pytest.raises(InputError, match=message):
        load_normals(tmp_path, frames())


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".png"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.95])
def test_truncated_maps_are_named(tmp_path, suffix, share):
    file = tmp_path / f"001{suffix}"
    if suffix == ".png":
        write_png(file, smooth_normals(), np.uint16)
    else:
        (np.save if suffix == ".npy" else np.savez)(file, smooth_normals())
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=f"001{suffix}") as error:
        load_normals(tmp_path, frames())
    assert "\n" not in str(error.value)
