from io import BytesIO

import cv2
import numpy as np
import pytest
from PIL import Image

from gsjax.errors import InputError
from gsjax.io.images import (
    check_image,
    filter_straight,
    image_size,
    read_image,
    read_mask,
    resize,
    same_shape,
    upright_size,
    write_image,
)


def noise(*shape, dtype=np.uint8, seed=0):
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)


def test_written_images_are_read_back_and_by_others_too(tmp_path):
    colors, rgba = noise(5, 7, 3), noise(5, 7, 4)
    write_image(tmp_path / "rgb.png", colors)
    write_image(tmp_path / "rgba.png", rgba)
    read, alpha = read_image(tmp_path / "rgb.png")
    np.testing.assert_array_equal(read, colors)
    assert alpha is None
    read, alpha = read_image(tmp_path / "rgba.png")
    np.testing.assert_array_equal(np.dstack([read, alpha]), rgba)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "rgb.png"))[..., ::-1], colors)
    assert image_size(tmp_path / "rgb.png") == (7, 5)
    with pytest.raises(InputError, match="cannot write"):
        write_image(tmp_path / "rgb.png/below.png", colors)


def test_grey_deep_and_palette_images_become_eight_bit_colours(tmp_path):
    deep = noise(6, 4, dtype=np.uint16)
    cv2.imwrite(str(tmp_path / "deep.png"), deep)
    colors, _ = read_image(tmp_path / "deep.png")
    np.testing.assert_array_equal(colors, np.rint(deep / 257.0).astype(np.uint8)[..., None].repeat(3, -1))
    grey = noise(6, 4)
    cv2.imwrite(str(tmp_path / "grey.png"), grey)
    np.testing.assert_array_equal(read_image(tmp_path / "grey.png")[0], grey[..., None].repeat(3, -1))
    palette = Image.fromarray(grey // 64 * 64).convert("P")
    palette.save(tmp_path / "palette.png")
    np.testing.assert_array_equal(read_image(tmp_path / "palette.png")[0], np.asarray(palette.convert("RGB")))


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


def test_filtering_straight_colours_equals_filtering_the_premultiplied_image():
    colors, alpha = noise(8, 12, 3), noise(8, 12, seed=1)
    alpha[:2, :2] = 0

    def halve(array):
        return resize(array, 6, 4)

    straight, coverage = filter_straight(colors, alpha, halve)

    def blocks(array):
        return array.reshape(4, 2, 6, 2, -1).mean((1, 3))

    expected_coverage = blocks(alpha / 255.0)[..., 0]
    premultiplied = blocks(colors * (alpha / 255.0)[..., None])
    expected = premultiplied / np.maximum(expected_coverage, 1e-6)[..., None]
    np.testing.assert_allclose(coverage, 255 * expected_coverage, atol=0.51)
    np.testing.assert_allclose(straight, expected, atol=0.51)
    assert (straight[0, 0] == 0).all() and coverage[0, 0] == 0


@pytest.mark.parametrize("full", [(5187, 3361), (4946, 3286), (1957, 1091), (641, 480)])
@pytest.mark.parametrize("factor", [1.0, 1.5, 1.9988, 2.0, 3.3, 4.0, 8.0])
def test_a_size_fits_whichever_way_its_sides_were_rounded(full, factor):
    sides = np.array(full) / factor
    for width in {int(np.floor(sides[0])), int(np.ceil(sides[0]))}:
        for height in {int(np.floor(sides[1])), int(np.ceil(sides[1]))}:
            assert same_shape((width, height), full) and same_shape(full, (width, height))


@pytest.mark.parametrize(
    ("size", "full", "fits"),
    [
        ((979, 546), (1957, 1091), True),  # Tanks and Temples
        ((1297, 840), (5187, 3361), True),  # Mip-NeRF 360, images_4
        ((979, 549), (1957, 1091), False),  # three rows more than half of them
        ((546, 979), (1957, 1091), False),
        ((1000, 1000), (1957, 1091), False),
        ((960, 540), (960, 544), False),  # four rows cut off
        ((1, 1), (1, 1), True),
    ],
)
def test_shapes_that_fit_and_that_do_not(size, full, fits):
    assert same_shape(size, full) == same_shape(full, size) == fits


@pytest.mark.parametrize(("orientation", "size"), [(None, (7, 5)), (1, (7, 5)), (3, (7, 5)), (6, (5, 7)), (8, (5, 7))])
def test_the_orientation_of_a_photo_turns_its_size_but_not_its_pixels(tmp_path, orientation, size):
    exif = Image.Exif()
    if orientation is not None:
        exif[0x0112] = orientation
    Image.fromarray(noise(5, 7, 3)).save(tmp_path / "a.jpg", exif=exif)
    assert upright_size(tmp_path / "a.jpg") == size
    assert image_size(tmp_path / "a.jpg") == (7, 5)
    assert read_image(tmp_path / "a.jpg")[0].shape == (5, 7, 3)


def test_tiffs_of_floats_and_of_more_bits_are_read_as_what_they_hold(tmp_path):
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


SIGNALLING = np.array([0x7FA00000], np.uint32).view(np.float32)[0]  # A NaN that numpy warns of where it is cast.


@pytest.mark.parametrize("beyond", [-0.1, 1.5, np.nan, SIGNALLING, np.inf, 1e9])
def test_floats_of_no_known_range_are_refused(tmp_path, beyond):
    pixels = np.full((6, 4), 0.5, np.float32)
    pixels[2, 2] = beyond
    Image.fromarray(pixels).save(tmp_path / "hdr.tif")
    with pytest.raises(InputError, match="hdr.tif: its pixels run from .* known are 0 to 1"):
        read_image(tmp_path / "hdr.tif")


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("bits", [10, 12])
def test_few_bits_in_sixteen_are_refused_and_not_black(tmp_path, name, channels, bits):
    deep = np.squeeze(noise(6, 4, channels).astype(np.uint16)) * 257
    cv2.imwrite(str(tmp_path / name), deep >> 16 - bits)
    with pytest.raises(InputError, match=f"{name}: has 16 bits, and its brightest pixel only .* of 65535"):
        read_image(tmp_path / name)
    cv2.imwrite(str(tmp_path / name), deep)
    assert read_image(tmp_path / name)[0].max() > 200


def test_an_object_out_of_view_in_sixteen_bits_is_an_empty_matte(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((6, 4, 4), np.uint16))
    colors, matte = read_image(tmp_path / "a.png")
    assert not colors.any() and matte is not None and not matte.any()


@pytest.mark.parametrize("name", ["a.heic", "a.jpg"])
def test_heic_is_read_by_its_bytes_whatever_its_name(tmp_path, name):
    heif = pytest.importorskip("pillow_heif")
    smooth = np.repeat(np.arange(0, 240, 6, dtype=np.uint8)[None, :, None], 30, 0).repeat(3, 2)
    heif.from_pillow(Image.fromarray(smooth)).save(tmp_path / "saved.heic", quality=95)
    (tmp_path / "saved.heic").rename(tmp_path / name)
    assert image_size(tmp_path / name) == upright_size(tmp_path / name) == (40, 30)
    assert np.abs(read_image(tmp_path / name)[0].astype(int) - smooth).max() <= 4


def test_a_side_of_millions_of_pixels_is_a_damaged_header(tmp_path):
    file = tmp_path / "a.bmp"
    Image.fromarray(np.zeros((9, 12, 3), np.uint8)).save(file)
    data = bytearray(file.read_bytes())
    data[18:22] = (134_217_740).to_bytes(4, "little")
    file.write_bytes(data)
    for read in (image_size, read_image):
        with pytest.raises(InputError, match="a.bmp: 134217740x9 pixels by its header, which is damaged"):
            read(file)


def test_photos_are_held_to_memory_and_not_to_a_fixed_number_of_pixels(tmp_path, monkeypatch):
    """Pillow refuses twice its limit, 179 megapixels: here as much more than a limit that is lowered."""
    cv2.imwrite(str(tmp_path / "panorama.png"), noise(30, 40, 3))
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    assert image_size(tmp_path / "panorama.png") == (40, 30)
    assert read_image(tmp_path / "panorama.png")[0].shape == (30, 40, 3)
    assert Image.MAX_IMAGE_PIXELS == 100
    Image.new("1", (12_000, 12_000)).save(tmp_path / "panorama.png")
    monkeypatch.setattr("gsjax.io.machine.free_memory", lambda: 2**30)
    with pytest.raises(
        InputError, match=r"panorama.png: a photo of 12000x12000 pixels takes 1.88 GiB of memory; 1 are"
    ):
        read_image(tmp_path / "panorama.png")


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "a.webp"])
def test_a_full_disk_is_told_and_leaves_no_part_of_an_image(tmp_path, monkeypatch, name):
    """As the system tells it: a write that is short, then none."""
    (tmp_path / name).write_bytes(b"the old one")

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(InputError, match=f"cannot write .*{name}: No space left on device"):
        write_image(tmp_path / name, noise(50, 70, 3))
    assert [file.name for file in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() == b"the old one"


def jpeg(progressive=False):
    smooth = cv2.resize(noise(5, 7, 3), (64, 48), interpolation=cv2.INTER_CUBIC)
    stream = BytesIO()
    Image.fromarray(smooth).save(stream, "JPEG", quality=90, progressive=progressive)
    return stream.getvalue()


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("end", [b"", b"\xff", bytes(9), b"\xff\xd9" + bytes(4096), b"\xff\xd9ftypmp42"])
def test_a_jpeg_with_another_end_is_read_whole_and_named_where_its_marker_is_missing(
    tmp_path, capsys, progressive, end
):
    data = jpeg(progressive)
    (tmp_path / "whole.jpg").write_bytes(data)
    (tmp_path / "a.jpg").write_bytes(data[:-2] + end)
    check_image(tmp_path / "a.jpg")
    np.testing.assert_array_equal(read_image(tmp_path / "a.jpg")[0], read_image(tmp_path / "whole.jpg")[0])
    message = capsys.readouterr().err
    if b"\xff\xd9" in end:
        assert message == ""
    elif not end.count(0):  # Behind zeros the decoder has all that it wants.
        assert message == f"{tmp_path / 'a.jpg'}: its end marker is missing, its pixels are all there; it is read\n"


@pytest.mark.parametrize("missing", [4, 8, 20, 200])
def test_a_jpeg_that_lacks_pixels_is_refused_with_and_without_its_end_marker(tmp_path, missing):
    (tmp_path / "a.jpg").write_bytes(jpeg()[:-missing])
    for reader in (check_image, read_image):
        with pytest.raises(InputError, match=r"a.jpg: not a whole image \(image file is truncated"):
            reader(tmp_path / "a.jpg")
