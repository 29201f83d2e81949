"""The pieces of a reconstruction that need no COLMAP: how photos are turned, matches, pairs, masks."""

from functools import partial

import numpy as np
import pycolmap
import pytest
from PIL import Image, ImageOps
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io.scenes import load_scene
from gsjax.io.sfm import dataset_writer, gps, pairs, source_photos
from gsjax.io.sfm import features as sift
from gsjax.io.sfm.features import Features, epipolar_regions, homography_regions, match

quietly = partial(tqdm, disable=True)


def photo(path, size=(40, 20), **tags):
    """A photo of noise, with EXIF tags by name."""
    exif = Image.Exif()
    details = exif.get_ifd(0x8769)
    for name, value in tags.items():
        where = {"make": (exif, 0x010F), "orientation": (exif, 0x0112), "focal": (details, 0xA405)}[name]
        where[0][where[1]] = value
    pixels = np.random.default_rng(0).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path, exif=exif)


def write_model(shots, folder, camera):
    """Writes the data set of photos without motion that one camera took; COLMAP's model is one made by hand."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    for number, shot in enumerate(shots, 1):
        image = pycolmap.Image(shot.name, np.empty((0, 2)), 1, number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    model.add_point3D(np.array([0, 0, 5.0]), pycolmap.Track(), np.zeros(3, np.uint8))
    dataset_writer.write_dataset(model, shots, folder, quietly)
    return load_scene(folder).frames


@pytest.mark.parametrize("orientation", range(1, 9))
def test_every_exif_orientation_ends_upright_by_way_of_the_sensor(tmp_path, orientation):
    for name, tags in (("a.png", {"orientation": orientation}), ("b.png", {})):
        photo(tmp_path / name, (20, 40), **tags)
    shot, _ = source_photos.list_source_photos(tmp_path)
    sensor, _ = shot.read()
    assert sensor.shape == (20, 40, 3)
    assert shot.size == (40, 20)
    with Image.open(tmp_path / "a.png") as picture:
        expected = np.asarray(ImageOps.exif_transpose(picture))
    np.testing.assert_array_equal(shot.upright(sensor), expected)


@pytest.mark.parametrize("turns", range(4))
def test_pose_and_pinhole_turn_with_the_picture(turns):
    K, width, height = np.array([[30.0, 0, 17], [0, 35, 12], [0, 0, 1]]), 40, 24
    pose = np.c_[np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0], [0.1, 0.2, 3.0]]
    point = np.array([0.3, -0.2, 0.4, 1.0])
    x, y, z = K @ pose @ point
    picture = np.zeros((height, width))
    picture[int(y / z), int(x / z)] = 1
    turned = np.rot90(picture, -turns)
    (fx, fy, cx, cy), new_width, new_height = source_photos.turned_pinhole(K, width, height, turns)
    assert turned.shape == (new_height, new_width)
    x_up, y_up, z_up = source_photos.turned_pose(pose, turns) @ point
    pixel = np.array([fx * x_up / z_up + cx, fy * y_up / z_up + cy])
    assert turned[int(pixel[1]), int(pixel[0])] == 1
    np.testing.assert_allclose(pixel, source_photos.turned_points(np.array([[x / z, y / z]]), width, height, turns)[0])


def unit(rng, count):
    vectors = rng.normal(size=(count, 128)).astype(np.float32)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def mutual_and_clear(a, b):
    """The definition, in a loop and float64."""
    angles = np.arccos(np.clip(a.astype(np.float64) @ b.T.astype(np.float64), -1, 1))

    def nearest(row):
        first, second = np.sort(row)[:2]
        return int(row.argmin()) if first < 0.7 and first < 0.8 * second else -1

    there, back = [nearest(row) for row in angles], [nearest(row) for row in angles.T]
    return [(i, j) for i, j in enumerate(there) if j >= 0 and back[j] == i]


def test_matches_are_those_of_the_definition(monkeypatch):
    monkeypatch.setattr(sift, "_BLOCK", 7)
    rng = np.random.default_rng(0)
    a = unit(rng, 40)
    b = a[rng.permutation(40)[:30]] + rng.uniform(0, 0.12, (30, 1)) * rng.normal(size=(30, 128))
    b = np.r_[b, b[:5] + 0.01 * rng.normal(size=(5, 128))].astype(np.float32)  # five with a twin: not clear
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    matches = match(a, b)
    assert 5 < len(matches) < 25
    assert matches.tolist() == [list(pair) for pair in mutual_and_clear(a, b)]
    assert match(a, b[:1]).shape == match(a[:0], b).shape == (0, 2)


def with_twins(xy, moved, apart):
    """Features in two photos, in the second of which each has a twin `apart`; without regions none is clear."""
    descriptors = np.random.default_rng(0).integers(0, 200, (len(xy), 128)).astype(np.uint8)
    a, b = Features(xy, descriptors), Features(np.r_[moved, moved + apart], np.r_[descriptors, descriptors])
    assert len(match(a.unit(), b.unit())) == 0
    return a, b


def test_along_epipolar_lines_twins_elsewhere_do_no_harm():
    xy = np.stack([np.full(20, 50.0), 20.0 * np.arange(20)], axis=-1)
    a, b = with_twins(xy, xy + [9, 0], [0, 300])
    along_rows = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # F of a camera that moved to the side
    matches = match(a.unit(), b.unit(), epipolar_regions(a, b, along_rows))
    assert matches[:5].tolist() == [[i, i] for i in range(5)]  # of the others a twin lies on the line of another


def test_where_one_plane_fills_both_photos_twins_along_the_line_do_no_harm_either():
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 400, (20, 2))
    plane = np.array([[1.1, 0.1, 9], [-0.1, 0.9, 4], [1e-4, -2e-4, 1]])
    moved = np.c_[xy, np.ones(20)] @ plane.T
    a, b = with_twins(xy, moved[:, :2] / moved[:, 2:] + rng.uniform(-1, 1, (20, 2)), [300, 0])
    matches = match(a.unit(), b.unit(), homography_regions(a, b, plane))
    assert matches.tolist() == [[i, i] for i in range(20)]
    back = match(b.unit(), a.unit(), homography_regions(b, a, np.linalg.inv(plane)))
    assert sorted(back[:, ::-1].tolist()) == matches.tolist()


@pytest.mark.parametrize(
    ("root", "masks"),
    [
        (".", {"a.jpg": "a.jpg.mask.png", "day/b.png": "day/b.mask.png"}),
        (".", {"a.jpg": "masks/a_mask.png", "day/b.png": "day/masks/b.png"}),
        (".", {"a.png": "Mask/a.png", "sub/a.png": "Mask/sub/a.png", "b.jpg": "Mask/b.jpg.png"}),
        ("images", {"images/a.png": "masks/a.png", "images/sub/a.png": "masks/sub/a.png"}),
        (".", {"images/a.png": "masks/a.png", "images/sub/a.png": "masks/sub/a.png"}),
    ],
)
def test_masks_are_masks_of_photos_and_no_photos(tmp_path, root, masks):
    """Next to photos, as RealityScan and Metashape write them, and in folders of them, in or next to the photos'."""
    for name in (*masks, *masks.values()):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        photo(tmp_path / name)
    shots = source_photos.list_source_photos(tmp_path / root)
    assert {shot.path: shot.mask_path for shot in shots} == {tmp_path / a: tmp_path / b for a, b in masks.items()}


def test_photos_that_are_damaged_or_whose_mask_is_are_left_out_and_named(tmp_path, capsys):
    for name in ("a.jpg", "b.jpg", "c.jpg", "d.png", "masks/c.jpg.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        photo(tmp_path / name)
    for name in ("b.jpg", "masks/c.jpg.png"):
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:-25])
    shots, faults = source_photos.usable_photos(tmp_path)
    assert [shot.name for shot in shots] == ["a.jpg", "d.png"]
    assert [fault.name for fault in faults] == ["b.jpg", "c.jpg"]
    assert f"{tmp_path}/b.jpg: not a whole image" in faults[0].reason and "masks/c.jpg.png: not" in faults[1].reason
    assert capsys.readouterr().err == ""
    assert len(source_photos.list_source_photos(tmp_path)) == 2
    assert "; 2 of 4 photos are left out: b.jpg, c.jpg\n" in capsys.readouterr().err
    (tmp_path / "d.png").write_bytes(b"")
    with pytest.raises(InputError, match="3 of 4 photos cannot be used, and 2 are needed: b.jpg, c.jpg, d.png"):
        source_photos.usable_photos(tmp_path)


@pytest.mark.parametrize(("orientation", "upright"), [(1, True), (6, True), (6, False)])
def test_masks_turn_with_the_pixels_or_with_the_picture(tmp_path, orientation, upright):
    photo(tmp_path / "a.png", orientation=orientation)
    photo(tmp_path / "b.png")
    (tmp_path / "masks").mkdir()
    with Image.open(tmp_path / "a.png") as picture:
        grey = picture.convert("L")
        turned = ImageOps.exif_transpose(grey)
        (turned if upright else grey).save(tmp_path / "masks/a.png", exif=Image.Exif())
    shot, other = source_photos.list_source_photos(tmp_path)
    np.testing.assert_array_equal(shot.upright(shot.read_mask()), np.asarray(turned))
    assert other.read_mask() is None
    Image.fromarray(np.zeros((9, 9), np.uint8)).save(tmp_path / "masks/a.png")
    with pytest.raises(InputError, match="masks/a.png: mask is 9x9, of another shape than"):
        shot.read_mask()


def test_photos_of_every_format_are_found_and_other_files_named(tmp_path):
    names = ["a.JPG", "b.webp", "c.tiff", "d.bmp", "e.avif"]
    for name in names:
        photo(tmp_path / name)
    (tmp_path / ".hidden").mkdir()
    (tmp_path / "raw").mkdir()
    for name in (".DS_Store", ".hidden/x.jpg", "notes", "raw/IMG_1.CR2", "clip.mov"):
        (tmp_path / name).write_bytes(b"x")
    assert [shot.name for shot in source_photos.list_source_photos(tmp_path)] == names
    unused = {"clip.mov": ".mov", "notes": "no ending", "raw/IMG_1.CR2": ".cr2"}
    expected = {name: f"{ending} is no format of photos that is read" for name, ending in unused.items()}
    assert source_photos.unused_files(tmp_path) == expected


def test_what_was_made_of_photos_is_not_taken_for_more_of_them(tmp_path):
    for name in ("a.jpg", "day 2/b.jpg", "scene/images/a.jpg", "runs/garden/pictures/0000.png"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        photo(tmp_path / name)
    (tmp_path / "scene/sparse/0").mkdir(parents=True)
    (tmp_path / "runs/garden/report.html").touch()
    for name in ("depth/a.png", "day 2/images_2/b.jpg", "Thumbnails/a.jpg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        photo(tmp_path / name)
    assert [shot.name for shot in source_photos.list_source_photos(tmp_path)] == ["a.jpg", "day 2/b.jpg"]
    unused = ["Thumbnails", "day 2/images_2", "depth", "runs/garden", "scene"]
    assert list(source_photos.unused_files(tmp_path)) == unused
    (tmp_path / "a.jpg").unlink()
    with pytest.raises(InputError, match="has 1; what .*Thumbnails holds was made of photos"):
        source_photos.list_source_photos(tmp_path)


def test_mattes_and_masks_are_published(tmp_path):
    """Four formats, two of them of one stem, upright and turned."""
    photos = tmp_path / "photos"
    (photos / "masks").mkdir(parents=True)
    rgba = np.random.default_rng(0).integers(0, 256, (20, 40, 4), dtype=np.uint8)
    turned = Image.Exif()
    turned[0x0112] = 6
    Image.fromarray(rgba).save(photos / "a.png", exif=turned)
    for name in ("a.tif", "b.webp", "c.jpg"):
        photo(photos / name)
    mask = np.full((20, 40), 255, np.uint8)
    mask[:, :20] = 0
    Image.fromarray(mask).save(photos / "masks/c.jpg.png")
    camera = pycolmap.Camera(camera_id=1, model="PINHOLE", width=40, height=20, params=[30.0, 30.0, 20.0, 10.0])
    published = write_model(source_photos.list_source_photos(photos), tmp_path / "scene", camera)
    frames = {frame.name: frame for frame in published}
    assert sorted(frames) == ["a.png", "a.tif.png", "b.jpg", "c.jpg"]
    np.testing.assert_array_equal(frames["a.png"].pixels().image, np.rot90(rgba[..., :3], -1))
    np.testing.assert_array_equal(frames["a.png"].pixels().matte, np.rot90(rgba[..., 3], -1))
    np.testing.assert_array_equal(frames["c.jpg"].pixels().valid, mask)
    assert all(frames[name].pixels().matte is None for name in ("a.tif.png", "b.jpg", "c.jpg"))
    assert all(frames[name].pixels().valid is None for name in ("a.png", "a.tif.png", "b.jpg"))


def test_photos_are_paired_with_those_taken_next_to_them_whatever_their_names():
    """A walk along a parallel, over the line where longitudes jump, its names shuffled; two photos have no GPS."""
    steps = np.random.default_rng(0).permutation(40)  # of the walk, by photo
    longitudes = 179.999 + 1e-4 * steps
    fixes = [gps.Fix(10.0, longitude - 360 * (longitude > 180), float("nan")) for longitude in longitudes]
    silent = np.isin(steps, (7, 25))
    photo_pairs = pairs.nearby_pairs([None if is_silent else fix for fix, is_silent in zip(fixes, silent, strict=True)])
    apart = np.abs(steps[:, None] - steps)
    near = (apart <= 4) & ~silent[:, None] & ~silent & np.triu(np.ones((40, 40), bool), 1)
    assert set(zip(*map(np.ndarray.tolist, np.nonzero(near)), strict=True)) <= photo_pairs
    assert max(apart[pair] for pair in photo_pairs) <= 11
    assert not any(silent[photo] for pair in photo_pairs for photo in pair)
    assert pairs.nearby_pairs([None, gps.Fix(0.0, 1.0, 0.0), None]) == set()
