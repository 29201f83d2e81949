from io import BytesIO
from itertools import product

import cv2
import numpy as np
import pytest
from PIL import Image

from gsjax.errors import InputError
from gsjax.io.exif import orientation_of
from gsjax.io.images import (
    check_image,
    image_size,
    open_image,
    read_image,
    read_mask,
    same_shape,
    upright_size,
    write_image,
)
from gsjax.io.sfm.source_photos import read_source_photo


def noise(*shape, dtype=np.uint8, seed=0):
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)


def test_masks_of_every_kind(tmp_path):
    mask = np.zeros((6, 4), np.uint8)
    mask[2:] = 255
    for name, stored in {
        "grey": mask,
        "ones": mask // 255,
        "labels": np.where(mask > 0, np.arange(24, dtype=np.uint8).reshape(6, 4), 0),
        "alpha": np.dstack([np.full_like(mask, 9)] * 3 + [mask]),
        "opaque": np.dstack([mask] * 3 + [np.full_like(mask, 255)]),
    }.items():
        write_image(tmp_path / f"{name}.png", stored)
        np.testing.assert_array_equal(read_mask(tmp_path / f"{name}.png"), mask, err_msg=name)


@pytest.mark.parametrize("full", [(5187, 3361), (641, 480)])
def test_a_size_fits_whichever_way_its_sides_were_rounded(full):
    for factor in (1.5, 1.9988, 3.3, 8.0):
        width, height = np.array(full) / factor
        sides = (int(np.floor(width)), int(np.ceil(width))), (int(np.floor(height)), int(np.ceil(height)))
        assert all(same_shape(size, full) and same_shape(full, size) for size in product(*sides))
    assert not same_shape((546, 979), (1957, 1091)), "turned"
    assert not same_shape((960, 540), (960, 544)), "four rows cut off"


def test_floats_and_more_bits_are_read_as_what_they_hold(tmp_path):
    grey = noise(6, 4)
    grey[0, :2] = 0, 255
    stored = {
        "shares": (grey / 255).astype(np.float32),
        "bytes": grey.astype(np.float32),
        "sixteen": grey.astype(np.uint16) * 257,
        "eight_in_sixteen": grey.astype(np.uint16),
        "ints": grey.astype(np.int32) * 257,
    }
    for name, pixels in stored.items():
        Image.fromarray(pixels).save(tmp_path / f"{name}.tif")
        np.testing.assert_array_equal(read_image(tmp_path / f"{name}.tif")[0], grey[..., None].repeat(3, -1), name)
    Image.fromarray((grey > 99).astype(np.uint16)).save(tmp_path / "mask.tif")
    np.testing.assert_array_equal(read_mask(tmp_path / "mask.tif"), 255 * (grey > 99))
    deep = noise(6, 4, dtype=np.uint16)
    cv2.imwrite(str(tmp_path / "deep.png"), deep)
    expected = np.rint(deep / 257.0).astype(np.uint8)[..., None].repeat(3, -1)
    np.testing.assert_array_equal(read_image(tmp_path / "deep.png")[0], expected)


SIGNALLING = np.array([0x7FA00000], np.uint32).view(np.float32)[0]  # A NaN that numpy warns of where it is cast.


@pytest.mark.parametrize("beyond", [-0.1, 1.5, SIGNALLING, np.inf])
def test_floats_of_no_known_range_are_refused(tmp_path, beyond):
    pixels = np.full((6, 4), 0.5, np.float32)
    pixels[2, 2] = beyond
    Image.fromarray(pixels).save(tmp_path / "hdr.tif")
    with pytest.raises(InputError, match="hdr.tif: its pixels run from .* known are 0 to 1"):
        read_image(tmp_path / "hdr.tif")


@pytest.mark.parametrize(("name", "channels", "bits"), [("a.png", 1, 10), ("a.png", 4, 12), ("a.tif", 3, 12)])
def test_few_bits_in_sixteen_are_refused_and_not_black(tmp_path, name, channels, bits):
    deep = np.squeeze(noise(6, 4, channels).astype(np.uint16)) * 257
    cv2.imwrite(str(tmp_path / name), deep >> 16 - bits)
    with pytest.raises(InputError, match=f"{name}: has 16 bits, and its brightest pixel only .* of 65535"):
        read_image(tmp_path / name)
    cv2.imwrite(str(tmp_path / name), deep)
    assert read_image(tmp_path / name)[0].max() > 200
    cv2.imwrite(str(tmp_path / "out_of_view.png"), np.zeros((6, 4, 4), np.uint16))
    colors, matte = read_image(tmp_path / "out_of_view.png")
    assert not colors.any() and matte is not None and not matte.any()


def test_photos_are_held_to_memory_and_not_to_a_fixed_number_of_pixels(tmp_path, monkeypatch):
    """Pillow refuses twice its limit, 179 megapixels, which is lowered here."""
    cv2.imwrite(str(tmp_path / "panorama.png"), noise(30, 40, 3))
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    assert image_size(tmp_path / "panorama.png") == (40, 30)
    assert read_image(tmp_path / "panorama.png")[0].shape == (30, 40, 3)
    assert Image.MAX_IMAGE_PIXELS == 100
    Image.new("1", (12_000, 12_000)).save(tmp_path / "panorama.png")
    monkeypatch.setattr("gsjax.io.machine.free_memory", lambda: 2**30)
    with pytest.raises(InputError, match="panorama.png: a photo of 12000x12000 pixels takes 1.88 GiB of memory; 1 are"):
        read_image(tmp_path / "panorama.png")


def jpeg():
    smooth = cv2.resize(noise(5, 7, 3), (64, 48), interpolation=cv2.INTER_CUBIC)
    stream = BytesIO()
    Image.fromarray(smooth).save(stream, "JPEG", quality=90)
    return stream.getvalue()


@pytest.mark.parametrize("end", [b"", bytes(9), b"\xff\xd9ftypmp42"])
def test_a_jpeg_with_another_end_is_read_whole_and_named_where_its_marker_is_missing(tmp_path, capsys, end):
    data = jpeg()
    (tmp_path / "whole.jpg").write_bytes(data)
    (tmp_path / "a.jpg").write_bytes(data[:-2] + end)
    check_image(tmp_path / "a.jpg")
    np.testing.assert_array_equal(read_image(tmp_path / "a.jpg")[0], read_image(tmp_path / "whole.jpg")[0])
    message = capsys.readouterr().err
    if b"\xff\xd9" in end:
        assert message == ""
    elif not end.count(0):  # Behind zeros the decoder has all that it wants.
        assert message == f"{tmp_path / 'a.jpg'}: its end marker is missing, its pixels are all there; it is read\n"


@pytest.mark.parametrize("missing", [4, 200])
def test_a_jpeg_that_lacks_pixels_is_refused(tmp_path, missing):
    (tmp_path / "a.jpg").write_bytes(jpeg()[:-missing])
    for reader in (check_image, read_image):
        with pytest.raises(InputError, match=r"a.jpg: not a whole image \(image file is truncated"):
            reader(tmp_path / "a.jpg")


HEADER = 14  # bytes: Exif, the kind of TIFF, and where its tags begin


def exif(orientation=6):
    tags = Image.Exif()
    tags.endian = ">"
    tags[0x010F], tags[0x8769], tags[0x0112] = "Maker", {0x920A: 4.2}, orientation
    return tags.tobytes()


def photo(path, data):
    Image.new("RGB", (40, 30), (9, 90, 200)).save(path, exif=data)
    return path


def orientation(path):
    with open_image(path) as picture:
        return orientation_of(picture)


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.webp"])
def test_the_orientation_of_every_format_turns_its_size_but_not_its_pixels(tmp_path, name):
    for value in range(1, 9):
        path = photo(tmp_path / name, exif(value))
        assert orientation(path) == value
        assert upright_size(path) == ((30, 40) if value >= 5 else (40, 30))
        assert image_size(path) == (40, 30) and read_image(path)[0].shape == (30, 40, 3)


@pytest.mark.parametrize("at", range(6, HEADER + 2))
def test_a_header_of_exif_that_is_damaged_loses_no_orientation(tmp_path, at):
    for byte in (0, 255):
        data = bytearray(exif())
        data[at] = byte
        assert orientation(photo(tmp_path / "a.jpg", bytes(data))) == 6


def test_exif_whose_orientation_cannot_be_read_is_told(tmp_path, capsys):
    path = photo(tmp_path / "a.jpg", b"Exif\0\0MM\0*\0\0\0\x08 nothing of it is left")
    assert read_source_photo(path, "a.jpg").to_upright == 0
    assert f"{path}: its EXIF is damaged; the photo is taken as it is stored" in capsys.readouterr().err
