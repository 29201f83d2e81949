"""The same photos in a world far off: a run ends with the same scores, where its user is."""

import shutil

import numpy as np
import pycolmap
import pytest
from trained_run import FEW_POINTS, SETTINGS

from gsjax import pipeline, runs
from gsjax.io import json_files
from gsjax.io.ply import read_gaussians
from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.scene.meshes import Mesh

SHIFT = np.array([500_000.0, 4_500_000.0, 100.0])  # as of coordinates in UTM


def moved(scene, out):
    """A copy of the built-in scene and its truth, every point p at p + `SHIFT`."""
    shutil.copytree(scene, out)
    model = pycolmap.Reconstruction(out / "sparse/0")
    for image in model.images.values():
        pose = image.cam_from_world().matrix()
        left, _, right = np.linalg.svd(pose[:, :3])  # Rotations of float32 are none at 4,500,000.
        there = pycolmap.Rigid3d(pycolmap.Rotation3d(left @ right), pose[:, 3] - left @ right @ SHIFT)
        image.frame.set_cam_from_world(image.camera_id, there)
    for point in model.points3D.values():
        point.xyz = point.xyz + SHIFT
    model.write_binary(out / "sparse/0")
    arrays = dict(np.load(out / "gt_points.npz"))
    np.savez(out / "gt_points.npz", **{**arrays, "points": arrays["points"].astype(np.float64) + SHIFT})
    mesh = read_mesh(out / "gt_mesh.ply")
    vertices = mesh.vertices.astype(np.float64) + SHIFT
    write_mesh(out / "gt_mesh.ply", Mesh(vertices, mesh.faces, mesh.colors))
    return out


def test_a_run_is_the_same_in_another_world_and_lies_at_its_photos(run, run_mesh, run_scores, scene, tmp_path):
    there = moved(scene, tmp_path / "scene")
    folder = tmp_path / "run"
    summary = pipeline.train(there, folder, SETTINGS)
    manifest = json_files.read(run / "manifest.json")
    assert summary["psnr"] == pytest.approx(manifest["psnr"], abs=0.1)
    ours, theirs = (runs.read_metrics(each) for each in (folder, run))
    assert [r["loss"] for r in ours] == pytest.approx([r["loss"] for r in theirs], rel=0.02)

    expected = read_gaussians(run / "gaussians.ply").means + SHIFT
    means = read_gaussians(folder / "gaussians.ply").means
    assert len(means) == pytest.approx(len(expected), rel=0.02)
    np.testing.assert_allclose(np.median(means, axis=0), np.median(expected, axis=0), atol=0.02)
    for record, original in zip(*(json_files.read(each / "cameras.json") for each in (folder, run)), strict=True):
        place, other = (-np.array(r["viewmat"])[:3, :3].T @ np.array(r["viewmat"])[:3, 3] for r in (record, original))
        np.testing.assert_allclose(place, other + SHIFT, atol=1e-5)

    files = tmp_path / "mesh.ply", run_mesh[0]
    report, theirs = pipeline.mesh(folder, files[0], **FEW_POINTS), run_mesh[1]
    mesh, other = map(read_mesh, files)
    low, high = (end(other.vertices.astype(np.float64), axis=0) + SHIFT for end in (np.min, np.max))
    np.testing.assert_allclose(mesh.vertices.min(axis=0), low, atol=0.1)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), high, atol=0.1)
    assert report["foreground"]["cell"] == pytest.approx(theirs["foreground"]["cell"], rel=0.05)
    ours, theirs = pipeline.evaluate(folder, mesh=files[0]), run_scores
    for name in ("chamfer", "depth_error", "threshold"):
        assert ours[name] == pytest.approx(theirs[name], rel=0.05), name
    assert ours["floor"]["chamfer"] == pytest.approx(theirs["floor"]["chamfer"], rel=0.05)
