"""Colours of photos that are not in sRGB, against closed forms of the colour spaces that they are in."""

import numpy as np
import pytest
from PIL import Image, ImageCms

from gsjax.io.color_profiles import matrix_profile
from gsjax.io.images import read_image, read_mask

SPACES = {  # x and y of red, green and blue, and the exponent of the curve; the white is D65
    "p3": (((0.68, 0.32), (0.265, 0.69), (0.15, 0.06)), 2.2),
    "adobe": (((0.64, 0.33), (0.21, 0.71), (0.15, 0.06)), 563 / 256),
    "bt2020": (((0.708, 0.292), (0.17, 0.797), (0.131, 0.046)), 2.4),
}
REC709 = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))


def to_xyz(primaries):
    """Linear RGB to XYZ, where white is D65."""
    columns = np.stack([(x / y, 1, (1 - x - y) / y) for x, y in (*primaries, (0.3127, 0.3290))], 1)
    return columns[:, :3] * np.linalg.solve(columns[:, :3], columns[:, 3])


def srgb_of(linear):
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def linear_of(srgb):
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def encoded(srgb, space, curve=None):
    """sRGB colours 0..1 in another space, bytes."""
    primaries, gamma = SPACES[space]
    linear = linear_of(srgb) @ (np.linalg.inv(to_xyz(primaries)) @ to_xyz(REC709)).T
    curved = np.clip(linear, 0, 1) ** (1 / gamma) if curve is None else curve(linear)
    return np.rint(255 * np.clip(curved, 0, 1)).astype(np.uint8)


def profile(space):
    primaries, gamma = SPACES[space]
    return matrix_profile(primaries, (0, (gamma,)))


LAB = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
LOSSY = "a.jpg", "a.heic"


def lively(side=32):
    """sRGB colours inside all of these spaces."""
    x, y = np.meshgrid(np.linspace(0.1, 0.9, side), np.linspace(0.1, 0.9, side))
    return np.stack([x, y, 1 - 0.5 * (x + y)], axis=-1)


def psnr(colors, srgb):
    return -10 * np.log10(np.mean((colors / 255.0 - srgb) ** 2))


@pytest.mark.parametrize(
    ("name", "space", "how"),
    [
        ("a.png", "p3", {}),
        ("a.tif", "adobe", {}),
        ("a.jpg", "p3", {"subsampling": 0}),
        ("a.heic", "bt2020", {"chroma": 444}),
    ],
)
def test_photos_of_every_format_are_converted_by_their_profile(tmp_path, name, space, how):
    if name == "a.heic":
        pytest.importorskip("pillow_heif").register_heif_opener()
    picture = Image.fromarray(encoded(lively(), space))
    picture.save(tmp_path / name, quality=100, icc_profile=profile(space), **how)
    assert psnr(read_image(tmp_path / name)[0], lively()) > (36 if name in LOSSY else 46)
    assert psnr(np.asarray(picture), lively()) < 32, "without the profile these are other colours"


def test_colours_with_alpha_are_converted_too(tmp_path):
    colors = encoded(lively(8), "adobe")
    alpha = np.arange(64, dtype=np.uint8).reshape(8, 8)
    Image.fromarray(np.dstack([colors, alpha])).save(tmp_path / "rgba.png", icc_profile=profile("adobe"))
    pixels, matte = read_image(tmp_path / "rgba.png")
    assert psnr(pixels, lively(8)) > 46 and np.array_equal(matte, alpha)


def test_a_profile_of_srgb_changes_no_byte_and_masks_have_none(tmp_path, capsys):
    colors = np.random.default_rng(0).integers(0, 256, (9, 9, 3), dtype=np.uint8)
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(colors).save(tmp_path / "a.png", icc_profile=srgb)
    assert np.array_equal(read_image(tmp_path / "a.png")[0], colors)
    Image.fromarray(colors[..., 0]).save(tmp_path / "m.png", icc_profile=profile("adobe"))
    assert np.array_equal(read_mask(tmp_path / "m.png"), colors[..., 0])
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("broken", [b"no profile", profile("p3")[:200], LAB])
def test_a_profile_that_cannot_be_used_is_one_line_and_the_colours_are_srgb(tmp_path, capsys, broken):
    colors = np.random.default_rng(0).integers(0, 256, (9, 9, 3), dtype=np.uint8)
    for name in ("a.png", "b.png"):
        Image.fromarray(colors).save(tmp_path / name, icc_profile=broken)
        assert np.array_equal(read_image(tmp_path / name)[0], colors)
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and f"{tmp_path / 'a.png'}: its colour profile cannot be used" in message


@pytest.mark.parametrize(
    ("primaries", "transfer", "space", "named"), [(12, 13, "p3", ""), (9, 16, None, "PQ"), (9, 18, None, "HLG")]
)
def test_heic_is_converted_by_its_code_points_or_named(tmp_path, capsys, primaries, transfer, space, named):
    """Without a profile; what is coded for high dynamic range is taken as it is stored."""
    heif = pytest.importorskip("pillow_heif")
    colors = np.rint(255 * lively()).astype(np.uint8) if space is None else encoded(lively(), space, srgb_of)
    how = {"color_primaries": primaries, "transfer_characteristics": transfer, "matrix_coefficients": 1}
    heif.from_pillow(Image.fromarray(colors)).save(tmp_path / "a.heic", quality=100, chroma=444, **how)
    assert psnr(read_image(tmp_path / "a.heic")[0], lively()) > 38
    message = capsys.readouterr().err
    assert message.count("\n") == bool(named)
    assert not named or f"a.heic: is coded for high dynamic range ({named})" in message
