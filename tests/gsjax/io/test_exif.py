"""The orientation of photos whose EXIF is damaged, byte by byte."""

import pytest
from PIL import Image

from gsjax.io.exif import is_adobe_rgb, orientation_of
from gsjax.io.images import image_size, open_image, read_image, upright_size
from gsjax.io.sfm.source_photos import read_source_photo

HEADER = 14  # bytes: Exif, the kind of TIFF, and where its tags begin


def exif(orientation=6, big=True):
    tags = Image.Exif()
    tags.endian = ">" if big else "<"
    tags[0x010F], tags[0x0112], tags[0x8769] = "Maker", orientation, {0x920A: 4.2}
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


def test_exif_that_ends_behind_the_orientation_loses_none_of_it(tmp_path):
    data = exif()
    end = data.index(b"\x01\x12\0\x03") + 12
    assert orientation(photo(tmp_path / "a.jpg", data[:end])) == 6
    assert orientation(photo(tmp_path / "b.jpg", data[: end - 8])) is None


def test_a_photo_without_exif_or_orientation_is_upright_as_stored(tmp_path):
    assert orientation(photo(tmp_path / "a.jpg", b"")) == 1
    tags = Image.Exif()
    tags[0x010F] = "Maker"
    assert orientation(photo(tmp_path / "b.jpg", tags.tobytes())) == 1


def test_exif_whose_orientation_cannot_be_read_is_told(tmp_path, capsys):
    path = photo(tmp_path / "a.jpg", b"Exif\0\0MM\0*\0\0\0\x08 nothing of it is left")
    assert read_source_photo(path, "a.jpg").to_upright == 0
    assert f"{path}: its EXIF is damaged; the photo is taken as it is stored" in capsys.readouterr().err
    with open_image(path) as picture:
        assert not is_adobe_rgb(picture)
