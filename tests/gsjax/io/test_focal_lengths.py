"""Focal lengths of EXIF: which photos share a camera, which are taken as a prior, and mapping without them."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io.sfm import initial_cameras, mapping, source_photos

quietly = partial(tqdm, disable=True)
SIZE = (300, 200)
PIXELS_A_MM = np.hypot(*SIZE) / np.hypot(36, 24)  # of 35 mm film


def photo(path, film=None, zoom=None, make="Maker", lens=4.2):
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = make, "Phone 1"
    details = exif.get_ifd(0x8769)
    for tag, value in ((0xA405, film), (0xA404, zoom), (0x920A, lens)):
        if value is not None:
            details[tag] = value
    pixels = np.random.default_rng(0).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path, exif=exif)


def priors_of(folder, *photos):
    """The prior focal length of each photo, mm of 35 mm film, None where there is none; and why some are ignored."""
    for number, tags in enumerate(photos):
        photo(folder / f"{number}.jpg", **tags)
    shots = source_photos.list_source_photos(folder)
    priors, ignored = initial_cameras.focal_priors(shots)
    cameras = initial_cameras.guess_cameras(shots, priors)
    focals = [camera.mean_focal_length() / PIXELS_A_MM if camera.has_prior_focal_length else None for camera in cameras]
    return cameras, focals, ignored


def test_another_digital_zoom_is_another_camera_and_none_is_none_however_it_is_written(tmp_path):
    zooms = (None, 1.0, IFDRational(0, 1), IFDRational(0, 0), 1.6)
    cameras, focals, _ = priors_of(tmp_path, *({"film": 28, "zoom": zoom} for zoom in zooms))
    assert len({camera.camera_id for camera in cameras[:4]}) == 1 != cameras[4].camera_id
    np.testing.assert_allclose(focals, [28] * 4 + [1.6 * 28], rtol=1e-3)


def test_a_35_mm_equivalent_that_changes_with_the_zoom_includes_it(tmp_path):
    """As phones write that note 45 for 28 mm zoomed by 1.6; and where no photo is without zoom."""
    _, focals, _ = priors_of(tmp_path, {"film": 28, "zoom": 1.0}, {"film": 45, "zoom": 1.6}, {"film": 84, "zoom": 3.0})
    np.testing.assert_allclose(focals, [28, 45, 84], rtol=1e-3)
    only_zoomed = tmp_path / "zoomed"
    only_zoomed.mkdir()
    _, focals, _ = priors_of(only_zoomed, {"film": 28, "zoom": 2.0}, {"film": 28, "zoom": 1.6})
    np.testing.assert_allclose(focals, [56, 44.8], rtol=1e-3)


def test_where_no_photo_shows_it_an_iphone_includes_the_zoom_and_others_leave_it_unknown(tmp_path):
    tags = {"film": 45, "zoom": 1.6}
    _, focals, ignored = priors_of(tmp_path, tags | {"make": "Apple"}, tags, {"film": 20, "lens": 2.2})
    np.testing.assert_allclose([focals[0], focals[2]], [45, 20], rtol=1e-3)
    assert focals[1] is None
    assert ignored == {"1.jpg": "it does not say whether 45 mm of 35 mm film includes its zoom 1.6"}


@pytest.mark.parametrize(
    ("film", "is_taken"), [(1, False), (7, False), (8, True), (26, True), (400, True), (401, False)]
)
def test_only_focal_lengths_of_lenses_are_taken_and_others_named(tmp_path, film, is_taken):
    cameras, focals, ignored = priors_of(tmp_path, {"film": film}, {"film": film})
    if is_taken:
        np.testing.assert_allclose(focals, film, rtol=1e-3)
        assert ignored == {}
    else:
        assert focals == [None, None]
        assert cameras[0].mean_focal_length() == pytest.approx(1.2 * 300), "as without EXIF"
        reason = f"{film} mm of 35 mm film is not between 8 and 400"
        assert ignored == {"0.jpg": reason, "1.jpg": reason}


def fake_model(registered, points=100):
    return SimpleNamespace(num_reg_images=lambda: registered, num_points3D=lambda: points)


@pytest.mark.parametrize(
    ("models", "index", "line"),
    [
        ([10], 0, ""),
        ([9, 20], 1, "9 of 20 photos get a pose with the focal lengths of EXIF, 20 without them; the model without"),
        ([9, 4], 0, "9 of 20 photos get a pose with the focal lengths of EXIF, 4 without them; the model with them"),
        ([None, 6], 1, "0 of 20 photos get a pose with the focal lengths of EXIF, 6 without them; the model without"),
    ],
)
def test_mapping_runs_again_without_priors_where_less_than_half_register(tmp_path, monkeypatch, models, index, line):
    outcomes, starts = [None if count is None else fake_model(count) for count in models], []

    def map_photos(material, workspace, progress):
        starts.append(material.cameras[0].has_prior_focal_length)
        if outcomes[len(starts) - 1] is None:
            raise InputError("no model found")
        return outcomes[len(starts) - 1], {}

    monkeypatch.setattr(mapping, "map_photos", map_photos)
    for number in range(20):
        photo(tmp_path / f"{number:02d}.jpg", film=135)
    shots = source_photos.list_source_photos(tmp_path)
    priors, _ = initial_cameras.focal_priors(shots)
    material = mapping.Material(shots, [], np.zeros((20, 20)), [])
    model, _, note = mapping.map_photos_with_priors(material, priors, tmp_path / "work", quietly)
    assert starts == [True, False][: len(models)]
    assert model is outcomes[index]
    assert note.startswith(line) and bool(note) == bool(line)
    with pytest.raises(InputError, match="no model found"):
        outcomes[:], starts[:] = [None, None], []
        mapping.map_photos_with_priors(material, priors, tmp_path / "again", quietly)
