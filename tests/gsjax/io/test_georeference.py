"""The place of a reconstruction by the GPS of its photos, and up by the gravity that phones and drones note."""

import struct
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from scipy.spatial.transform import Rotation

from gsjax.io.georeference_files import read_place, write_place
from gsjax.io.sfm import gps, source_photos
from gsjax.io.sfm.georeference import georeference, place_model
from gsjax.io.sfm.gps import Fix
from gsjax.io.sfm.gravity import MAKER_NOTE, up_by_gravity

COUNT = 40
TURN = Rotation.from_rotvec([1.0, 2.0, 0.5])  # of a model's own world
MUNICH, SANTIAGO, FIJI = (48.1, 11.5, 520.0), (-33.45, -70.66, 570.0), (-17.8, 179.9999, 5.0)
EARTH = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)


def write_photo(path, latitude, longitude, altitude=None, **changed):
    """A photo with GPS in degrees, minutes and seconds; `changed` replaces tags by their number: `t2=...`."""
    exif = Image.Exif()
    table = exif.get_ifd(gps.TAG)
    table[1], table[3] = "NS"[latitude < 0], "EW"[longitude < 0]
    table[2], table[4] = sexagesimal(latitude), sexagesimal(longitude)
    if altitude is not None:
        table[5], table[6] = bytes([altitude < 0]), IFDRational(Fraction(abs(altitude)).limit_denominator(1000))
    for name, value in changed.items():
        table[int(name[1:])] = value
    Image.new("RGB", (40, 20)).save(path, exif=exif)


def sexagesimal(degrees):
    seconds = Fraction(abs(degrees) * 3600).limit_denominator(10**5)
    whole, left = divmod(seconds, 3600)
    return tuple(IFDRational(part) for part in (whole, left // 60, left % 60))


def fix_of(folder, *place, **changed):
    write_photo(folder / "a.jpg", *place, **changed)
    return source_photos.read_source_photo(folder / "a.jpg", "a.jpg").fix


@pytest.mark.parametrize("place", [MUNICH, SANTIAGO, FIJI, (31.5, 35.5, -430.0)])
def test_gps_is_read_on_every_side_of_the_earth_and_below_the_sea(tmp_path, place):
    np.testing.assert_allclose(fix_of(tmp_path, *place), place, atol=1e-6)


def test_damaged_gps_is_told_in_words(tmp_path):
    latitude = IFDRational(48), IFDRational(6, 0), IFDRational(0)
    assert "latitude is no angle" in fix_of(tmp_path, *MUNICH, t2=latitude)
    assert "longitude does not say E or W" in fix_of(tmp_path, *MUNICH, t3="")


def flight(around, noise, path="ring", roll=2.0, seed=0):
    """Poses in a model of its own turn, size and place, the GPS of every photo, and the true places in metres."""
    rng = np.random.default_rng(seed)
    turn = np.linspace(0, 2 * np.pi, COUNT, endpoint=False)
    places = {
        "ring": np.c_[40 * np.cos(turn), 30 * np.sin(turn), 5 * np.sin(3 * turn)],
        "line": np.c_[40 * np.cos(turn), 20 * np.cos(turn), 0 * turn],
    }[path]
    rotation, viewmats = TURN.as_matrix(), []
    for place in places:
        forward = rng.normal(size=3) - place - [0, 0, 15]
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        roll_matrix = Rotation.from_rotvec(np.radians(roll) * rng.normal() * forward).as_matrix()
        axes = np.stack([roll_matrix @ right, roll_matrix @ np.cross(forward, right), forward]) @ rotation.T
        center = (rotation @ place + [1, 2, 3]) / 7.3
        viewmats.append(np.c_[axes, -axes @ center])
    degrees = EARTH.enu_to_ellipsoid(places + noise * rng.normal(size=places.shape), *around)
    return np.stack(viewmats), [Fix(*row) for row in degrees], places


def errors(viewmats, place, places):
    """Degrees of tilt, and the largest distance from the true places in shares of their extent."""
    positions = place.points_to_world(-np.einsum("vji,vj->vi", viewmats[:, :, :3], viewmats[:, :, 3]))
    up = np.array(place.rotation) @ TURN.apply([0, 0, 1.0])
    off = positions - positions.mean(0) - places + places.mean(0)
    return np.degrees(np.arccos(min(up[2], 1.0))), np.linalg.norm(off, axis=1).max() / np.ptp(places, axis=0).max()


@pytest.mark.parametrize("around", [SANTIAGO, FIJI])
def test_a_flight_comes_out_level_and_true_to_scale(around):
    viewmats, fixes, places = flight(around, noise=0.3)
    solution = georeference(viewmats, fixes)
    tilt, off = errors(viewmats, solution.place, places)
    assert tilt < 1 and off < 0.01
    assert solution.errors == {} and solution.place.is_known
    middle = EARTH.ellipsoid_to_enu(np.array([solution.place.origin]), *around)[0]
    assert np.linalg.norm(middle - np.median(places, axis=0)) < 0.5


def test_wrong_gps_is_told_apart_and_not_followed():
    viewmats, fixes, places = flight(MUNICH, noise=0.3)
    fixes[3] = fixes[3]._replace(latitude=fixes[3].latitude + 0.01)
    fixes[9], fixes[11] = Fix(12.0, 13.0, 14.0), None
    solution = georeference(viewmats, fixes)
    tilt, off = errors(viewmats, solution.place, places)
    assert tilt < 1 and off < 0.01
    assert list(solution.errors) == [3, 9] and solution.errors[3] == pytest.approx(1112, rel=0.01)


def test_gps_on_a_line_leaves_up_to_the_cameras_and_says_so():
    viewmats, fixes, places = flight(MUNICH, noise=0.3, path="line")
    solution = georeference(viewmats, fixes)
    tilt, off = errors(viewmats, solution.place, places)
    assert "up by the cameras (by the GPS " in solution.summary
    assert tilt < 2 and off < 0.03  # What is held to 2 degrees by each of 40 hands.


def test_gps_of_two_photos_tells_no_scale_and_is_not_followed():
    viewmats, fixes, _ = flight(MUNICH, noise=3.0)
    solution = georeference(viewmats, [*fixes[:2], *[None] * (COUNT - 2)])
    assert not solution.place.is_known and "in 2 of 40 photos" in solution.summary


def model_of(viewmats, point):
    """A model of these poses with one point, and the number of the point."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pycolmap.Camera.create_from_model_name(1, "PINHOLE", 30, 40, 20))
    for number, pose in enumerate(viewmats, start=1):
        image = pycolmap.Image(name=f"{number}.jpg", camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    return model, model.add_point3D(point, pycolmap.Track(), np.zeros(3, np.uint8))


def test_a_model_is_brought_to_its_place_with_its_points(tmp_path):
    viewmats, fixes, places = flight(SANTIAGO, noise=0.0)
    beacon = np.array([3.0, -4.0, 2.0])
    model, point = model_of(viewmats, (TURN.apply(beacon) + [1, 2, 3]) / 7.3)
    placement = place_model(model, [SimpleNamespace(fix=fix, to_upright=0, gravity=None) for fix in fixes])
    origin = EARTH.ellipsoid_to_enu(np.array([placement.place.origin]), *SANTIAGO)[0]
    np.testing.assert_allclose(model.point3D(point).xyz + origin, beacon, atol=1e-3)
    centers = np.stack([model.image(number).projection_center() for number in range(1, COUNT + 1)])
    np.testing.assert_allclose(centers + origin, places, atol=1e-3)
    assert not placement.place.moves  # What is written is in the world already.
    write_place(tmp_path, placement.place)
    assert read_place(tmp_path) == placement.place


RNG = np.random.default_rng(0)
XMP = '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description drone-dji:GimbalRollDegree="{:+.2f}" drone-dji:GimbalPitchDegree="{:+.2f}"/></x:xmpmeta>'  # noqa: E501


def apple_note(vector):
    """Apple's maker note with two entries, the second of which is the accelerometer's."""
    numbers = [part for number in vector for part in Fraction(number).limit_denominator(10**6).as_integer_ratio()]
    entries = struct.pack(">HHII", 1, 9, 1, 14) + struct.pack(">HHII", 8, 10, 3, 46)
    return b"Apple iOS\0\0\x01MM" + struct.pack(">H", 2) + entries + bytes(6) + struct.pack(">6i", *numbers)


def noted(folder, *, note=None, xmp=None, orientation=1, lens=None):
    exif = Image.Exif()
    exif[0x0112] = orientation
    details = exif.get_ifd(0x8769)
    if note is not None:
        details[MAKER_NOTE] = note
    if lens is not None:
        details[0xA434] = lens
    Image.new("RGB", (40, 20)).save(folder / "a.jpg", exif=exif, **({} if xmp is None else {"xmp": xmp.encode()}))
    return source_photos.read_source_photo(folder / "a.jpg", "a.jpg").gravity


LOW, LEANING = np.radians([30, 10])


@pytest.mark.parametrize(
    ("orientation", "vector", "expected"),
    [
        (6, (0, -1, 0), (0, 1, 0)),  # upright
        (1, (-1, 0, 0), (0, 1, 0)),  # its top to the left
        (8, (0, 1, 0), (0, 1, 0)),  # upside down
        (6, (0, -np.cos(LOW), -np.sin(LOW)), (0, np.cos(LOW), np.sin(LOW))),  # its back looks down, its screen up
        (6, (np.sin(LEANING), -np.cos(LEANING), 0), (np.sin(LEANING), np.cos(LEANING), 0)),  # its right side is lower
    ],
)
def test_a_phone_says_where_down_is_however_it_is_held(tmp_path, orientation, vector, expected):
    """Its axes are x right, y to its top, z out of the screen; the picture stands on EXIF's orientation."""
    down = noted(tmp_path, note=apple_note(vector), orientation=orientation)
    np.testing.assert_allclose(down, expected, atol=1e-5)


def test_a_gimbal_says_it_by_pitch_and_roll(tmp_path):
    np.testing.assert_allclose(noted(tmp_path, xmp=XMP.format(0, -90)), [0, 0, 1], atol=1e-6)
    tilted = np.radians([35, 4])
    expected = np.cos(tilted[0]) * np.sin(tilted[1]), np.cos(tilted[0]) * np.cos(tilted[1]), np.sin(tilted[0])
    np.testing.assert_allclose(noted(tmp_path, xmp=XMP.format(4, -35)), expected, atol=1e-6)


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {"note": apple_note((0, -1, 0))[:40]},  # cut off
        {"note": apple_note((0, -1.4, 0))},  # shaken
        {"note": apple_note((0.1, 0.1, -0.99))},  # looks straight down: no edge is the lower one
        {"note": apple_note((0, -1, 0)), "lens": "iPhone 12 front camera 2.71mm f/2.2"},
        {"xmp": XMP.replace("Pitch", "Yaw").format(0, 0)},
    ],
)
def test_what_does_not_tell_it_says_nothing(tmp_path, tags):
    assert noted(tmp_path, **tags) is None


def poses(count, tilted=3.0):
    """Cameras about a world of its own turn, what each noted of down, and the direction up in that world."""
    rotations = Rotation.from_euler("zxy", RNG.uniform(-40, 40, (count, 3)), degrees=True)
    viewmats = np.concatenate([(rotations * TURN).as_matrix(), RNG.normal(size=(count, 3, 1))], axis=2)
    up = TURN.inv().apply([0, -1.0, 0])
    noise = Rotation.from_rotvec(np.radians(tilted) * RNG.normal(size=(count, 3)))
    return viewmats, [tuple(down) for down in noise.apply(-viewmats[:, :, :3] @ up)], up


def test_most_photos_decide_and_the_error_is_told():
    viewmats, downs, up = poses(30)
    downs[4], downs[7] = (1.0, 0.0, 0.0), None
    estimate = up_by_gravity(viewmats, downs)
    off = np.arccos(estimate.direction @ up)
    assert np.degrees(off) < 2 and off < 4 * estimate.error < np.radians(5)
    assert estimate.source == "the gravity that 28 photos noted"


def test_without_gps_a_model_is_turned_upright_and_its_folder_says_so(tmp_path):
    viewmats, downs, up = poses(12, tilted=0.0)
    model, point = model_of(viewmats, 5 * up)
    placement = place_model(model, [SimpleNamespace(fix=None, to_upright=0, gravity=down) for down in downs])
    np.testing.assert_allclose(model.point3D(point).xyz, [0, 0, 5], atol=1e-6)
    assert placement.summary.endswith("`gsjax scale` sets it; upright by the gravity that 12 photos noted")
    assert not placement.place.is_known and not placement.place.moves and placement.place.up == (0, 0, 1)
    write_place(tmp_path, placement.place)
    assert read_place(tmp_path) == placement.place
