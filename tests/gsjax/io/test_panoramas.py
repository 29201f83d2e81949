"""Panoramas of 360 degrees through structure from motion: poses and faces against a world that is known."""

from functools import partial

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io.files import make_folder
from gsjax.io.scenes import load_scene
from gsjax.io.sfm import dataset_writer, initial_cameras, mapping, reconstruct, source_photos
from gsjax.io.sfm.features import Features
from gsjax.io.sfm.pairs import likeness

WIDTH, HEIGHT, PHOTOS, POINTS = 256, 128, 6, 400
quietly = partial(tqdm, disable=True)


def seen_at(points, rotation, center):
    """Pixels of points in a panorama: longitude from the left, latitude from above; z ahead, y down."""
    x, y, z = ((points - center) @ rotation.T).T
    longitude, latitude = np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))
    return np.stack([WIDTH * (0.5 + longitude / (2 * np.pi)), HEIGHT * (0.5 + latitude / np.pi)], -1)


@pytest.fixture(scope="module")
def world():
    """Points all around, and cameras that walk among them, turned anyhow."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(POINTS, 3))
    points = directions / np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(2, 6, (POINTS, 1))
    centers = np.c_[0.4 * np.arange(PHOTOS), 0.2 * rng.normal(size=(PHOTOS, 2))]
    turns = Rotation.from_euler("yxz", rng.uniform(-1, 1, (PHOTOS, 3)) * [180, 20, 20], degrees=True).as_matrix()
    return points, turns, centers


@pytest.fixture(scope="module")
def scene(world, tmp_path_factory):
    """The data set that is made of what the panoramas see of the points, every point with a descriptor of its own."""
    root = tmp_path_factory.mktemp("panoramas")
    make_folder(root / "photos")
    for number in range(PHOTOS):
        grey = np.full((HEIGHT, WIDTH, 3), 40 * number, np.uint8)
        Image.fromarray(grey).save(root / f"photos/{number}.png")
    shots = source_photos.as_panoramas(source_photos.list_source_photos(root / "photos"), 60.0)
    descriptors = np.random.default_rng(1).integers(0, 255, (POINTS, 128)).astype(np.uint8)
    features = [Features(seen_at(world[0], *pose), descriptors) for pose in zip(*world[1:], strict=True)]
    material = mapping.Material(shots, features, likeness(features, quietly), initial_cameras.guess_cameras(shots, {}))
    model, left_out = mapping.map_photos(material, make_folder(root / "work"), quietly)
    assert left_out == {}
    dataset_writer.write_dataset(model, shots, make_folder(root / "scene"), quietly)
    return load_scene(root / "scene")


def test_poses_are_those_of_the_world_up_to_a_similarity(world, scene):
    _, turns, centers = world
    fronts = [frame for frame in scene.frames if "_front" in frame.name]
    assert [frame.name for frame in fronts] == [f"{number}_front.png" for number in range(PHOTOS)]
    for a, b in ((0, 1), (2, 5)):
        ours = fronts[b].viewmat[:3, :3] @ fronts[a].viewmat[:3, :3].T
        np.testing.assert_allclose(ours, turns[b] @ turns[a].T, atol=1e-3)
    positions = np.stack([-frame.viewmat[:3, :3].T @ frame.viewmat[:3, 3] for frame in fronts])
    apart, true = (np.linalg.norm(np.diff(each, axis=0), axis=1) for each in (positions, centers))
    np.testing.assert_allclose(apart / apart[0], true / true[0], rtol=2e-3)


def test_a_face_is_masked_where_the_panorama_is(scene):
    """By the closed form of the panorama, in pixels of the panorama."""
    for frame in (frame for frame in scene.frames if frame.name.startswith("3_")):
        y, x = np.meshgrid(np.arange(frame.height) + 0.5, np.arange(frame.width) + 0.5, indexing="ij")
        rays = np.stack([(x - frame.K[0, 2]) / frame.K[0, 0], (y - frame.K[1, 2]) / frame.K[1, 1], np.ones_like(x)], -1)
        front = next(f for f in scene.frames if f.name == "3_front.png")
        in_panorama = rays @ (frame.viewmat[:3, :3] @ front.viewmat[:3, :3].T)
        panorama_y = seen_at(in_panorama.reshape(-1, 3), np.eye(3), np.zeros(3))[:, 1].reshape(x.shape)
        valid = frame.pixels().valid
        is_valid = np.ones(x.shape, bool) if valid is None else valid > 127
        limit = HEIGHT * (0.5 + 60 / 180)
        assert is_valid[panorama_y < limit - 2].all(), frame.name
        assert not is_valid[panorama_y > limit + 2].any(), frame.name


def test_what_is_no_panorama_is_refused(tmp_path):
    for name in "ab":
        Image.fromarray(np.zeros((40, 60, 3), np.uint8)).save(tmp_path / f"{name}.png")
    with pytest.raises(InputError, match="a.png: is 60x40; a panorama of 360 degrees is twice as broad as high"):
        source_photos.as_panoramas(source_photos.list_source_photos(tmp_path), None)
    with pytest.raises(InputError, match="mask_below=30: is for panoramas of 360 degrees"):
        reconstruct(tmp_path, tmp_path / "scene", mask_below=30.0)
