"""SOG: within its steps of what was written, its bytes by hand, and what is refused."""

import json
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from packed_files import FIELDS, ROUNDING, clouds, turns_apart
from scipy.special import expit
from tolerances import assert_close

from gsjax.errors import InputError
from gsjax.io import quantization
from gsjax.io.images import lossless_webp
from gsjax.io.packing import morton_order
from gsjax.io.sog import read_sog, write_sog


def parts_of(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def written_parts(path, parts):
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content if isinstance(content, bytes) else json.dumps(content))
    return path


def half_gaps(values, entries):
    """Half of the distance between the two entries about each value, which the nearest one is within."""
    entries = np.asarray(entries, np.float64)
    place = np.clip(np.searchsorted(entries, values), 1, len(entries) - 1)
    inside = (values >= entries[0]) & (values <= entries[-1])
    beyond = np.maximum(entries[0] - values, values - entries[-1])
    return np.where(inside, (entries[place] - entries[place - 1]) / 2, beyond)


@settings(max_examples=12, deadline=None)
@given(gaussians=clouds)
def test_sog_keeps_everything_to_its_steps(tmp_path_factory, gaussians):
    path = tmp_path_factory.mktemp("sog") / "g.sog"
    assert write_sog(path, gaussians) == 0
    meta = json.loads(parts_of(path)["meta.json"])
    read = read_sog(path)
    order = morton_order(gaussians.means.astype(np.float64))
    expected = {field: getattr(gaussians, field)[order].astype(np.float64) for field in FIELDS}
    for field in FIELDS:
        assert getattr(read, field).shape == expected[field].shape
        assert getattr(read, field).dtype == np.float32 and np.isfinite(getattr(read, field)).all(), field
    # Of ln(1 + |x|), so of x (1 + |x|) times it.
    step = np.subtract(meta["means"]["maxs"], meta["means"]["mins"]) / 65535
    bound = (step / 2 * (1 + 1e-3) + ROUNDING) * (1 + np.abs(expected["means"]))
    assert (np.abs(read.means - expected["means"]) <= bound).all()
    assert turns_apart(expected["quats"], read.quats) <= 3.1 * np.sqrt(2) / 255 / 2
    assert np.abs(expit(read.logit_opacities) - expit(expected["logit_opacities"])).max(initial=0) <= 0.5 / 255 + 1e-6
    for field, part in (("log_scales", "scales"), ("sh_dc", "sh0"), ("sh_rest", "shN")):
        if expected[field].size:
            entries = meta[part]["codebook"]
            assert (np.abs(getattr(read, field)) <= np.abs(entries).max() * (1 + 1e-6)).all()
            error = np.abs(getattr(read, field) - expected[field])
            assert (error <= half_gaps(expected[field], entries) + 10 * ROUNDING).all(), field


def test_a_codebook_is_fine_where_the_values_are_and_a_far_value_costs_one_entry():
    values = np.random.default_rng(0).normal(size=20_000)
    alone, with_far = (quantization.codebook(np.append(values, far)) for far in ([], [1e30, -1e30]))
    for entries in (alone, with_far):
        error = values - entries[quantization.nearest_labels(values, entries)]
        # The best of 256 levels has sqrt(pi sqrt(3) / 2) / 256 of the deviation (Panter and Dite 1951).
        assert np.sqrt(np.mean(error**2)) < 2 * np.sqrt(np.pi * np.sqrt(3) / 2) / 256
    few = np.float32([3, -1, 3, 7e20, 0.1] * 9)
    entries = quantization.codebook(few)
    np.testing.assert_array_equal(entries[quantization.nearest_labels(few, entries)], few)


def test_a_palette_finds_rows_that_come_again():
    """Of 50 kinds of rows with a little noise every one is told apart by 600 of a palette."""
    random = np.random.default_rng(1)
    kinds, kind = random.normal(size=(50, 9)).astype(np.float32), random.integers(50, size=4000)
    rows = kinds[kind] + random.normal(size=(4000, 9)).astype(np.float32) * np.float32(0.01)
    palette, labels = quantization.palette(rows, 600)
    assert len(palette) <= 600
    assert np.abs(palette[labels] - rows).max() < 0.1
    assert np.sqrt(np.mean((palette[labels] - rows) ** 2)) < 0.01


def by_hand():
    """Two Gaussians by the document: at (0, e - 1, -3) and (1, 0, 0), the first turned by 60 degrees about x."""
    ln4 = float(np.log(4))

    def image(*pixels):
        padded = np.zeros((4, 4, len(pixels[0])), np.uint8)
        padded.reshape(16, -1)[: len(pixels)] = pixels
        return lossless_webp(padded)

    book = [-1.0, 0.5, 2.0, *[9.0] * 253]
    ends = {"mins": [0, 0, -ln4], "maxs": [float(np.log(2)), 1, 0]}
    half = round((0.5 * np.sqrt(0.5) + 0.5) * 255)
    return {
        "means_l.webp": image([0, 255, 0], [255, 0, 255]),
        "means_u.webp": image([0, 255, 0], [255, 0, 255]),
        "scales.webp": image([0, 1, 2], [2, 1, 0]),
        "quats.webp": image([half, 128, 128, 252], [128, 128, 128, 255]),
        "sh0.webp": image([1, 1, 0, 0], [2, 0, 1, 51]),
        "shN_centroids.webp": lossless_webp(
            np.tile(np.arange(6, dtype=np.uint8).reshape(1, 6, 1) // 2, (1, 32, 3))  # Rows 0 0 1 and 1 2 2, and again.
        ),
        "shN_labels.webp": image([1, 0, 0], [0, 0, 0]),
        "meta.json": {
            "version": 2,
            "count": 2,
            "antialias": True,
            "means": {**ends, "files": ["means_l.webp", "means_u.webp"]},
            "scales": {"codebook": book, "files": ["scales.webp"]},
            "quats": {"files": ["quats.webp"]},
            "sh0": {"codebook": book, "files": ["sh0.webp"]},
            "shN": {"count": 64, "bands": 1, "codebook": book, "files": ["shN_centroids.webp", "shN_labels.webp"]},
        },
    }


def test_sog_by_hand(tmp_path):
    read = read_sog(written_parts(tmp_path / "g.sog", by_hand()))
    assert_close(read.means, np.float32([[0, np.e - 1, -3], [1, 0, 0]]))
    assert_close(read.log_scales, np.float32([[-1, 0.5, 2], [2, 0.5, -1]]))
    assert np.abs(read.quats - [[np.sqrt(0.75), 0.5, 0, 0], [0, 0, 0, 1]]).max() < 8e-3
    assert_close(read.sh_dc[:, 0], np.float32([[0.5, 0.5, -1], [2, -1, 0.5]]))  # Under an alpha of 0 too.
    assert_close(expit(read.logit_opacities), np.float32([0.25 / 255, 0.2]))
    assert_close(read.sh_rest[..., 0], np.float32([[0.5, 2, 2], [-1, -1, 0.5]]))
    assert read.pixel_filter == "mip"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 3}, "SOG of version 3, not 2"),
        ({"count": 17}, r"means_l.webp: 4x4 pixels for 17"),
        ({"count": 200_000_000}, "200000000 Gaussians takes .* GiB of memory"),
        ({"quats": {"files": ["../../x"]}}, r"not a SOG file, it holds no '../../x'"),
        ({"quats": {"files": ["sh0.webp"]}}, "quaternions whose largest component is none of four"),
        ({"shN": by_hand()["meta.json"]["shN"] | {"count": 1}}, "labels of harmonics beyond the 1 that there are"),
        ({"means": {"mins": [0, 0, 0], "maxs": [99, 0, 0], "files": ["means_l.webp"] * 2}}, "beyond what float32"),
    ],
)
def test_what_is_no_sog_is_named(tmp_path, changes, message):
    parts = by_hand()
    parts["meta.json"] |= changes
    with pytest.raises(InputError, match=rf"g.sog: .*{message}"):
        read_sog(written_parts(tmp_path / "g.sog", parts))
