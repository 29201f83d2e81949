"""Features by networks in ONNX files, shown on graphs of known function: the brightest pixels, told apart by colour."""

from functools import partial
from types import SimpleNamespace

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image
from small_graphs import PROJECTION, SmallGraph, brightest_pixels, small_lightglue
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io.sfm import learned, reconstruct
from gsjax.io.sfm.source_photos import list_source_photos, read_source_photo

quietly = partial(tqdm, disable=True)
needs_opencv_5 = pytest.mark.skipif(not hasattr(cv2, "ALIKED"), reason="OpenCV older than 5.0")
SIDES = {"aliked": 640, "disk": 1024}
WIDTH, HEIGHT, FOCAL = 480, 360, 576.0  # what is guessed of a photo that does not tell: 1.2 of its longer side


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    folder = tmp_path_factory.mktemp("weights")
    return {kind: brightest_pixels(folder / f"{kind}.onnx", kind, side) for kind, side in SIDES.items()}


def write_dots(file, columns, rows, colors, size, thickness=1):
    """A black photo of this size, in dots of `thickness` pixels, with dots in these columns and rows."""
    image = np.zeros((size[1], size[0], 3), np.uint8)
    image[rows, columns] = colors
    file.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(file), np.repeat(np.repeat(image, thickness, 0), thickness, 1)[..., ::-1])


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Photos of 140 dots in space, each of a colour of its own, and the cameras' rotations."""
    rng = np.random.default_rng(1)
    points = rng.uniform([-3, -2, -2], [3, 2, 2], (140, 3))
    colors = np.unique(rng.integers(60, 256, (200, 3)), axis=0)[rng.permutation(190)[:140]]
    rotations, folder = {}, tmp_path_factory.mktemp("world")
    for number, angle in enumerate(np.radians(np.linspace(-16, 16, 6))):
        rotation = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        camera_points = points @ rotation.T + [0, 0.2 * number, 10]
        xy = np.floor(FOCAL * camera_points[:, :2] / camera_points[:, 2:] + [WIDTH / 2, HEIGHT / 2]).astype(int)
        inside = ((xy >= 4) & (xy < [WIDTH - 4, HEIGHT - 4])).all(axis=1)
        columns, rows = xy[inside].T
        write_dots(folder / f"photos/{number}.png", columns, rows, colors[inside], (WIDTH, HEIGHT))
        rotations[f"{number}.png"] = rotation
    return folder / "photos", rotations


@needs_opencv_5
@pytest.mark.parametrize("kind", SIDES)
def test_features_lie_where_the_network_says_and_where_the_mask_is_on(tmp_path, weights, kind):
    side, rng = SIDES[kind], np.random.default_rng(0)
    width, height = side, side * 3 // 4  # of the photo once it is reduced to a half
    places = rng.choice((width - 20) * (height - 20), 150, replace=False)
    rows, columns = places // (width - 20) + 10, places % (width - 20) + 10
    colors = np.c_[255 - np.arange(150), rng.integers(0, 100, (150, 2))]
    for name in ("masked", "whole"):
        write_dots(tmp_path / f"photos/{name}.png", columns, rows, colors, (width, height), thickness=2)
    mask = np.full((2 * height, 2 * width), 255, np.uint8)
    mask[:, :width] = 0
    (tmp_path / "photos/masks").mkdir()
    cv2.imwrite(str(tmp_path / "photos/masks/masked.png.png"), mask)
    shots = list_source_photos(tmp_path / "photos")
    (masked, whole), matcher = learned.find_features(shots, kind, weights[kind], None, quietly)
    assert matcher is None
    expected = np.c_[2 * columns + 1, 2 * rows + 1]  # the middle of four pixels
    order = np.argsort(-colors.sum(axis=1), kind="stable")  # the most certain first
    np.testing.assert_allclose(sorted(whole.xy.tolist()), sorted(expected.tolist()), atol=1e-3)
    brightness = {tuple(xy): value for xy, value in zip(expected.tolist(), colors.sum(axis=1), strict=True)}
    values = [brightness[tuple(xy)] for xy in np.rint(whole.xy).tolist()]
    assert values == colors.sum(axis=1)[order].tolist()
    right = expected[expected[:, 0] > width]
    assert 0 < len(right) < 150
    np.testing.assert_allclose(sorted(masked.xy.tolist()), sorted(right.tolist()), atol=1e-3)
    described = colors[order] @ PROJECTION
    described /= np.linalg.norm(described, axis=1, keepdims=True)
    same = (whole.unit()[:, None] * described).sum(axis=-1).max(axis=1)  # Equally bright ones may change places.
    np.testing.assert_allclose(same, 1, atol=1e-5)


def test_a_photo_is_shown_upright_and_its_features_turned_back(tmp_path):
    stored, exif = np.random.default_rng(0).integers(0, 250, (200, 300, 3), dtype=np.uint8), Image.Exif()
    stored[[50, 160], [80, 210]] = 255
    exif[0x0112] = 6  # to be turned clockwise
    Image.fromarray(stored).save(tmp_path / "photo.png", exif=exif)
    mask = np.full((200, 300), 255, np.uint8)
    mask[150:170, 200:220] = 0
    Image.fromarray(mask).save(tmp_path / "mask.png")

    def brightest(picture, mask):
        assert mask is None and picture.shape == (640, 640, 3)
        np.testing.assert_array_equal(picture[170:470, 220:420, ::-1], np.rot90(stored, -1))  # In the middle, as BGR.
        np.testing.assert_array_equal(picture[0], picture[170])  # The border is continued outwards.
        white = np.argwhere(picture.sum(axis=-1) == 765)
        return [cv2.KeyPoint(float(x), float(y), 1) for y, x in white], np.ones((len(white), 128), np.float32)

    detector = learned.DETECTORS["aliked"]._replace(gain=1.0)
    shot = read_source_photo(tmp_path / "photo.png", "photo.png", tmp_path / "mask.png")
    features = learned._features(SimpleNamespace(detectAndCompute=brightest), detector, tmp_path, shot)
    np.testing.assert_allclose(features.xy, [[80.5, 50.5]])


@needs_opencv_5
def test_photos_of_dots_get_their_poses_from_aliked_and_lightglue(tmp_path, weights, world):
    photos, rotations = world
    glue = small_lightglue(tmp_path / "lightglue.onnx")
    options = {"features": "aliked", "weights": weights["aliked"], "matcher_weights": glue}
    report = reconstruct(photos, tmp_path / "scene", **options, progress=quietly)
    assert (report.registered, report.left_out) == (6, {})
    assert report.points > 100 and report.mean_track_length > 4 and report.mean_reprojection_error < 0.5
    model = pycolmap.Reconstruction(tmp_path / "scene/sparse/0")
    poses = {image.name: image.cam_from_world().matrix()[:, :3] for image in model.images.values()}
    for name, rotation in rotations.items():
        ours, theirs = poses[name] @ poses["0.png"].T, rotation @ rotations["0.png"].T
        angle = np.degrees(np.arccos(np.clip((np.trace(ours @ theirs.T) - 1) / 2, -1, 1)))
        assert angle < 1.0, name


def test_what_does_not_go_together_is_refused_before_anything_is_read(tmp_path):
    (tmp_path / "weights.onnx").write_bytes(b"")
    file = tmp_path / "weights.onnx"
    for options, message in (
        ({"features": "aliked"}, "features=aliked: needs the file of its weights"),
        ({"weights": file}, "go with features=aliked or disk, not with SIFT"),
        ({"features": "disk", "weights": file, "matcher_weights": file}, "LightGlue matches features of aliked"),
        ({"features": "disk", "weights": tmp_path / "none.onnx"}, "none.onnx: no such file of weights"),
    ):
        with pytest.raises(InputError, match=message):
            reconstruct(tmp_path / "photos", tmp_path / "scene", **options)
    assert [path.name for path in tmp_path.iterdir()] == ["weights.onnx"]


@needs_opencv_5
def test_files_that_are_no_such_network_are_named_in_one_line(tmp_path, weights, world):
    shots = list_source_photos(world[0])

    def refused(kind, file, matcher=None):
        with pytest.raises(InputError) as raised:
            features, glue = learned.find_features(shots[:2], kind, file, matcher, quietly)
            assert glue is not None
            glue(0, 1)
        assert "\n" not in str(raised.value)
        return str(raised.value)

    text = tmp_path / "text.onnx"
    text.write_text("no graph")
    graph = SmallGraph()
    graph.output(graph.affine(graph.input("x", (1, 3, 8, 8))), "y", shape=(1, 3, 8, 8))
    other = graph.save(tmp_path / "other.onnx")
    assert f"text.onnx: no ONNX graph that OpenCV {cv2.__version__} loads" in refused("aliked", text)
    assert "other.onnx: is no graph of DISK as OpenCV" in refused("disk", other)
    assert "disk.onnx: is no graph of ALIKED" in refused("aliked", weights["disk"])
    assert "other.onnx: is no graph of LightGlue" in refused("aliked", weights["aliked"], other)
