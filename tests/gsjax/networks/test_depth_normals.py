"""Normals of networks for depth, through a graph that gives a photo's red and green as 16 bits of disparity."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from small_graphs import SmallGraph
from small_scenes import angles, camera_at
from tqdm import tqdm

from gsjax import pipeline
from gsjax.errors import InputError
from gsjax.io.normal_maps import normal_maps
from gsjax.networks.estimators import DepthEstimator, DepthNormals
from gsjax.networks.records import DepthNetwork, Output, Size
from gsjax.normals.fitted_depth import fit_depth
from gsjax.scene import Pixels, Scene, Tracks, frame_of
from gsjax.scene.cameras import pixel_rays

CAMERA = camera_at(size=(64, 48), focal=60.0)
RAYS = np.asarray(pixel_rays(CAMERA), np.float64)
SCALE, SHIFT = 0.8, 0.05
RECORD = DepthNetwork(licence="none", size=Size("multiple"), white=255.0, kind="disparity", depth=Output(("seen",)))
TILTED = np.array([0.5, -0.4, -1.0]) / np.linalg.norm([0.5, -0.4, -1.0])


def plane(normal=TILTED, distance=3.0):
    """Depth `[H, W]` and normals `[H, W, 3]` of a plane that crosses the axis at `distance`."""
    return distance * normal[2] / (RAYS @ normal), np.broadcast_to(normal, RAYS.shape)


def ball_before_a_wall(center=(0.1, -0.1, 3.0), radius=0.7, wall=6.0):
    center = np.array(center)
    along, squared = RAYS @ center, np.sum(RAYS * RAYS, -1)
    root = along**2 - squared * (center @ center - radius**2)
    depth = np.where(root > 0, (along - np.sqrt(np.maximum(root, 0))) / squared, wall)
    normals = np.where((root > 0)[..., None], (RAYS * depth[..., None] - center) / radius, [0, 0, -1])
    return depth, normals, root > 0


def photo(depth):
    """What the network turns into `(1 / depth - SHIFT) / SCALE`."""
    levels = np.rint(65535 * (1 / depth - SHIFT) / SCALE).astype(int)
    return np.stack([levels // 256, levels % 256, 0 * levels], -1).astype(np.uint8)


def network(file):
    graph = SmallGraph()
    bytes_ = graph.affine(graph.input("image"), np.array([256, 1, 0]) / 65535)
    graph.output(graph.add("ReduceSum", bytes_, graph.constant([1], np.int64)), "seen")
    return graph.save(file)


def scene_of(depths, tmp_path, *, photo_depths=None, matched=200):
    """Photos of depth maps from one place, with points on them, a fifth of which were matched wrongly."""
    rng = np.random.default_rng(3)
    K, viewmat = np.asarray(CAMERA.K), np.asarray(CAMERA.viewmat)
    frames = [frame_of(f"{i}.png", viewmat, K, Pixels(photo(d))) for i, d in enumerate(photo_depths or depths)]
    rays, points = [], []
    for depth in depths:
        y, x = rng.integers(0, 48, matched), rng.integers(0, 64, matched)
        wrong = rng.random(matched) < 0.2
        far = depth[y, x] * np.where(wrong, rng.uniform(0.3, 3, matched), 1)
        rays.append(RAYS[y, x, :2])
        points.append(RAYS[y, x] * far[:, None])
    photos = np.repeat(np.arange(len(depths), dtype=np.int32), matched)
    tracks = Tracks(
        tuple(frame.name for frame in frames),
        photos,
        np.arange(len(photos), dtype=np.int32),
        np.concatenate(rays).astype(np.float32),
    )
    points = np.concatenate(points).astype(np.float32)
    return Scene(tmp_path, "colmap", tuple(frames), points, np.zeros_like(points, np.uint8), tracks=lambda: tracks)


def test_planes_and_balls_have_their_normals_and_edges_have_none(tmp_path):
    ball_depth, ball_normals, on_ball = ball_before_a_wall()
    scene = scene_of([plane()[0], ball_depth], tmp_path)
    estimate = DepthNormals(DepthEstimator(RECORD, network(tmp_path / "w.onnx")), scene)
    normals, fit = estimate(scene.frames[0])
    assert fit.fault is None and fit.points == 200
    assert (fit.scale, fit.shift) == (pytest.approx(SCALE, rel=1e-3), pytest.approx(SHIFT, abs=1e-3))
    assert np.any(normals, -1).mean() > 0.99
    assert angles(normals[np.any(normals, -1)], TILTED).max() < 0.3
    normals, _ = estimate(scene.frames[1])
    has_normal = np.any(normals, -1)
    silhouette = on_ball[1:-1, 1:-1] & ~(
        on_ball[:-2, 1:-1] & on_ball[2:, 1:-1] & on_ball[1:-1, :-2] & on_ball[1:-1, 2:]
    )
    assert silhouette.sum() > 40 and not has_normal[1:-1, 1:-1][silhouette].any()
    assert has_normal.mean() > 0.85 and has_normal[on_ball].mean() > 0.6
    assert angles(normals[has_normal & ~on_ball], [0, 0, -1]).max() < 1.0, "the wall beside the ball is a wall"
    assert np.median(angles(normals[has_normal & on_ball], ball_normals[has_normal & on_ball])) < 5.0


def test_photos_that_the_network_gets_wrong_are_named_and_empty_and_without_tracks_none_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(pipeline.normals.__globals__, "tqdm", partial(tqdm, disable=True))
    depth = plane()[0]
    noise = 1 / (0.2 + 0.3 * np.random.default_rng(0).random(depth.shape))
    scene = scene_of([depth, depth, depth], tmp_path, photo_depths=[depth, 1 / (0.8 - 1 / depth), noise])
    monkeypatch.setitem(pipeline.normals.__globals__, "load_scene", lambda *_, **__: scene)
    record = {"licence": "none", "size": {"rule": "multiple"}, "white": 255, "kind": "disparity"}
    (tmp_path / "r.json").write_text(json.dumps({**record, "depth": {"names": ["seen"]}}))
    report = pipeline.normals(tmp_path, tmp_path / "r.json", network(tmp_path / "w.onnx"), tmp_path / "maps")
    assert report["rejected"].startswith("2 of 3: 1.png (what the network sees nearer is farther away); 2.png (")
    assert report["fit"].startswith("0.0 % off the tracks' depth, explains 1.00")
    coverage = [np.any(read(), -1).mean() for read in normal_maps(tmp_path / "maps", scene.frames).values()]
    assert coverage[0] > 0.99 and coverage[1:] == [0, 0]
    with pytest.raises(InputError, match="has no tracks of structure from motion, which set scale and shift"):
        DepthNormals(DepthEstimator(RECORD, network(tmp_path / "w.onnx")), replace(scene, tracks=None))


def test_a_fit_says_why_it_must_not_be_used():
    rng = np.random.default_rng(0)
    depths, values = rng.uniform(2, 4, 100), rng.random(100)
    assert fit_depth(1 / depths[:19], depths[:19], "disparity").fault == "19 points, of 20 that a fit takes"
    assert "farther away" in str(fit_depth(-1 / depths, depths, "disparity").fault)
    assert fit_depth(np.ones(100), depths, "disparity").fault is not None
    unrelated = [fit_depth(rng.random(100), depths, "disparity").fault for _ in range(20)]
    assert None not in unrelated, "noise explains nothing"
    assert fit_depth(values, 1 / (values + 0.2), "disparity").fault is None
