"""Cameras around Gaussians that have none of their own, and circles of cameras."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from meshes import mesh_of
from small_scenes import discs

from gsjax.runs import viewpoints
from gsjax.scene import cameras as cams


def sphere(count, radius):
    points = np.random.default_rng(0).normal(size=(count, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def cloud(points):
    """Spheres of 8 centimetres."""
    return discs(points, np.array([0.0, 0.0, 1.0]), 0.08, thickness=1.0, opacity=0.98)


def test_an_object_is_looked_at_from_all_around():
    place = 70.0, -20.0, 5.0
    cameras = viewpoints.cameras_around(cloud(sphere(600, 1.0) + place))
    eyes = np.array([np.asarray(cams.center(c)) for c in cameras]) - place
    assert np.linalg.norm(eyes, axis=1).min() > 1.5
    directions = eyes / np.linalg.norm(eyes, axis=1, keepdims=True)
    assert np.abs(directions.mean(axis=0)).max() < 0.1
    forward = np.array([np.asarray(c.viewmat)[2, :3] for c in cameras])
    np.testing.assert_allclose(np.sum(forward * directions, axis=1), -1, atol=0.02)


@pytest.mark.parametrize(("count", "hidden_at", "size", "within"), [(150, 9.0, 1.5, 9.0), (500, 5.4, 0.35, 4.0)])
def test_what_its_surroundings_hide_is_looked_at_from_within_them(count, hidden_at, size, within):
    walls = 1900 - count  # One shape, one compilation.
    room = cloud(np.concatenate([sphere(walls, 4.0), sphere(count, hidden_at)]))
    room = replace(room, log_scales=room.log_scales.at[walls:].set(np.log(size)))
    eyes = np.array([np.asarray(cams.center(c)) for c in viewpoints.cameras_around(room)])
    assert np.linalg.norm(eyes, axis=1).max() < within


def test_a_circle_is_as_high_and_as_wide_as_the_cameras_of_the_run():
    middle = np.array([5.0, -2.0, 3.0])
    angles = np.radians([0.0, 90.0, 180.0, 270.0])
    heights = np.array([1.0, 1.5, 2.0, 1.5])
    eyes = middle + np.stack([4 * np.cos(angles), 4 * np.sin(angles), heights], axis=-1)
    up = np.array([0.0, 0, 1])
    K = np.float32([[50, 0, 32], [0, 50, 24], [0, 0, 1]])
    level = [cams.Camera(cams.look_at(eye, np.array([*middle[:2], eye[2]]), up), K, 64, 48) for eye in eyes]
    circle = viewpoints.camera_circle(cloud(sphere(600, 0.5) + middle), level)
    around = np.array([np.asarray(cams.center(camera)) for camera in circle]) - middle
    np.testing.assert_allclose(around[:, 2], 1.5, atol=0.05)
    np.testing.assert_allclose(np.hypot(around[:, 0], around[:, 1]), 4.0, atol=0.1)


def test_a_circle_of_a_mesh_is_twenty_degrees_above_it_and_every_view_holds_all_of_it():
    box, up = trimesh.creation.box((2.0, 1.0, 3.0)), np.array([0.3, 0.5, 1.0])
    mesh = mesh_of(box.vertices + [5, -3, 4], box.faces)
    circle, unit = viewpoints.camera_circle_of_mesh(mesh, up), up / np.linalg.norm(up)
    assert len(circle) == 36
    offsets = np.array([np.asarray(cams.center(camera)) for camera in circle]) - [5, -3, 4]
    heights = offsets @ unit / np.linalg.norm(offsets, axis=1)
    np.testing.assert_allclose(heights, np.sin(np.radians(20)), atol=0.02)
    for camera, offset in zip(circle, offsets, strict=True):
        viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
        projections = (mesh.vertices @ viewmat[:3, :3].T + viewmat[:3, 3]) @ K.T
        pixels = projections[:, :2] / projections[:, 2:]
        assert (projections[:, 2] > 0).all() and (pixels > 0).all() and (pixels < 512).all()
        assert np.ptp(pixels, axis=0).max() > 200, "the mesh fills the view"
        assert viewmat[1, :3] @ unit == pytest.approx(-np.cos(np.radians(20)), abs=0.02), "up is up in the picture"
        np.testing.assert_allclose(viewmat[2, :3], -offset / np.linalg.norm(offset), atol=0.02)
    height = np.linalg.norm(offsets[0]) * np.sin(np.radians(20))
    np.testing.assert_allclose(offsets.mean(axis=0), height * unit, atol=0.1)
