"""Which way is down, as phones and drones note it in their photos, and the model that is turned upright by it."""

import struct
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from gsjax.io.georeference_files import read_place, write_place
from gsjax.io.sfm import source_photos
from gsjax.io.sfm.georeference import place_model
from gsjax.io.sfm.gravity import MAKER_NOTE, up_by_gravity

RNG = np.random.default_rng(0)
XMP = '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description drone-dji:GimbalRollDegree="{:+.2f}" drone-dji:GimbalPitchDegree="{:+.2f}"/></x:xmpmeta>'  # noqa: E501
# A phone held still: its axes are x right, y to its top, z out of the screen; the picture stands on EXIF's orientation.
HOLDS = {"upright": (6, (0, -1, 0)), "top to the left": (1, (-1, 0, 0)), "top to the right": (3, (1, 0, 0)),
         "upside down": (8, (0, 1, 0))}  # fmt: skip


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


@pytest.mark.parametrize("hold", HOLDS)
def test_a_level_phone_has_down_at_the_lower_edge_however_it_is_held(tmp_path, hold):
    orientation, vector = HOLDS[hold]
    np.testing.assert_allclose(noted(tmp_path, note=apple_note(vector), orientation=orientation), [0, 1, 0], atol=1e-6)


def test_a_phone_that_looks_down_and_leans_says_so(tmp_path):
    # Held upright, turned 30 degrees so that its back looks down: the screen's normal points up.
    down = noted(tmp_path, note=apple_note((0, -np.cos(np.pi / 6), -np.sin(np.pi / 6))), orientation=6)
    np.testing.assert_allclose(down, [0, np.cos(np.pi / 6), np.sin(np.pi / 6)], atol=1e-5)
    # Its right side is lower by 10 degrees: down leans to the right edge of the picture.
    leaning = noted(tmp_path, note=apple_note((np.sin(0.17), -np.cos(0.17), 0)), orientation=6)
    np.testing.assert_allclose(leaning, [np.sin(0.17), np.cos(0.17), 0], atol=1e-5)


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
        {"note": b"Apple iOS\0\0\x01XX" + bytes(30)},
        {"note": apple_note((0, -1.4, 0))},  # shaken
        {"note": apple_note((0.1, 0.1, -0.99))},  # looks straight down: no edge is the lower one
        {"note": apple_note((0, -1, 0)), "lens": "iPhone 12 front camera 2.71mm f/2.2"},
        {"note": b"Nikon\0\2\0\0\0MM"},
        {"xmp": XMP.replace("Pitch", "Yaw").format(0, 0)},
    ],
)
def test_what_does_not_tell_it_says_nothing(tmp_path, tags):
    assert noted(tmp_path, **tags) is None


def poses(count, tilted=3.0):
    """Cameras about a world of its own turn, what each noted of down, and the direction up in that world."""
    turn = Rotation.from_rotvec([1.0, 2.0, 0.5])
    rotations = Rotation.from_euler("zxy", RNG.uniform(-40, 40, (count, 3)), degrees=True)
    viewmats = np.concatenate([(rotations * turn).as_matrix(), RNG.normal(size=(count, 3, 1))], axis=2)
    up = turn.inv().apply([0, -1.0, 0])
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
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pycolmap.Camera.create_from_model_name(1, "PINHOLE", 30, 40, 20))
    for number, pose in enumerate(viewmats, start=1):
        image = pycolmap.Image(name=f"{number}.jpg", camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    point = model.add_point3D(5 * up, pycolmap.Track(), np.zeros(3, np.uint8))
    placement = place_model(model, [SimpleNamespace(fix=None, to_upright=0, gravity=down) for down in downs])
    np.testing.assert_allclose(model.point3D(point).xyz, [0, 0, 5], atol=1e-6)
    assert placement.summary.endswith("`gsjax scale` sets it; upright by the gravity that 12 photos noted")
    assert not placement.place.is_known and not placement.place.moves and placement.place.up == (0, 0, 1)
    write_place(tmp_path, placement.place)
    assert read_place(tmp_path) == placement.place
