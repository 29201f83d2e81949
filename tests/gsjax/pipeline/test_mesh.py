"""A 3DGS file that was not trained here becomes a mesh, by every method; options out of range are one line."""

import shutil
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy import ndimage

from gsjax.errors import InputError, NoSurfaceError
from gsjax.gaussians import Gaussians, take
from gsjax.io import json_files
from gsjax.io.ply import write_gaussians
from gsjax.meshing import select_method
from gsjax.meshing.export import read_mesh
from gsjax.meshing.methods import METHODS, MeshMethod
from gsjax.meshing.track_visibility import TrackRays
from gsjax.meshing.tsdf import tsdf
from gsjax.normals.from_depth import depth_normals
from gsjax.pipeline import mesh_views
from gsjax.pipeline.mesh import mesh
from gsjax.rendering import gallery
from gsjax.runs import viewpoints
from gsjax.runs.result import open_result, write_views
from gsjax.scene import Pixels, frame_of
from gsjax.scene.meshes import Mesh, signed_volume
from gsjax.stereo import StereoMap, write_stereo_maps


@pytest.fixture
def file(ball, tmp_path, monkeypatch):
    monkeypatch.setattr(viewpoints, "SIZE", 64)
    monkeypatch.setattr(viewpoints, "COUNT", 16)
    write_gaussians(tmp_path / "ball.ply", ball.gaussians)
    return tmp_path / "ball.ply"


@pytest.mark.parametrize("method", METHODS)
def test_any_ply_becomes_a_mesh_without_cameras(file, method, tmp_path):
    options = {"fill_holes": True, "points": 20_000} if method == "poisson" else {}
    report = mesh(file, tmp_path / "mesh.glb", method=method, **options)
    result = read_mesh(tmp_path / "mesh.glb")
    assert result.num_faces == report["faces"] > 1000
    assert report["facing_share"] > 0.99
    radii = np.linalg.norm(result.vertices, axis=1)
    assert np.median(np.abs(radii - 1)) < 0.11
    if method == "poisson":
        assert report["topology"]["watertight"]
        assert report["holes"] == {"patches": 0, "closed": 0, "closed_faces": 0}
        assert signed_volume(result) == pytest.approx(4 / 3 * np.pi, rel=0.06)


@pytest.mark.parametrize(("count", "winner"), [(400, "tsdf"), (90, "poisson")])
def test_auto_selects_the_mesh_that_the_tracks_meet(lumpy, tmp_path, monkeypatch, count, winner):
    """Balls of which one is where the tracks end; fewer than 100 lines of sight tell of none.

    Candidates are built from two of the ten views and a tenth of the points; the winner from all.
    """
    directions = np.random.default_rng(0).normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    poisson = METHODS["poisson"]
    radii, calls, rendered, draw = {"poisson": 1.1, "empty": None, "tsdf": 1.0}, [], [], gallery.pictures

    def make(options, _, ids, *, name):
        calls.append((name, options.points, list(ids)))
        return name

    def pictures_of(gaussians, cameras, *arguments, **options):
        rendered.append(len(cameras))
        return draw(gaussians, cameras, *arguments, **options)

    def extract(gaussians, cameras, pictures, *, method, **options):
        assert len(list(pictures)) == len(cameras) == len(calls[-1][2])
        if radii[method] is None:
            raise NoSurfaceError("no surface to extract: as here")
        sphere = trimesh.creation.icosphere(subdivisions=3, radius=radii[method])
        return Mesh(sphere.vertices, sphere.faces, np.full(sphere.vertices.shape, 128, np.uint8)), {}

    monkeypatch.delitem(METHODS, "tsdf")
    monkeypatch.setattr(gallery, "pictures", pictures_of)
    monkeypatch.setattr(mesh_views, "are_floaters", lambda gaussians, views: np.arange(2000) == 1999)
    monkeypatch.setitem(mesh.__globals__, "FEWEST_TRIED", 2)
    for name in radii:
        monkeypatch.setitem(METHODS, name, MeshMethod("a sphere", partial(make, name=name), poisson.options))
    lines = TrackRays(3 * directions, 0.99 * directions)
    monkeypatch.setattr(select_method, "track_rays", lambda data: lines)
    monkeypatch.setattr(select_method, "silhouettes_of", lambda data: ())
    monkeypatch.setitem(mesh.__globals__, "extract_mesh", extract)
    monkeypatch.setitem(mesh.__globals__, "scene_of_run", lambda *_: "of the photos")
    report = mesh(lumpy["unmasked"], tmp_path / "mesh.ply", method="auto", points=200_000, photo_refine=False)
    assert report["method"] == winner and report["floaters"] == 1
    assert rendered == [10, 10], "once more without the floaters"
    candidates = [(name, 20_000, [0, 9]) for name in radii] if winner == "tsdf" else []
    assert calls == [*candidates, (winner, 200_000, list(range(10)))]
    assert {name: one["met"] > 0.9 for name, one in report["tried"].items()} == (
        {"poisson": False, "tsdf": True} if winner == "tsdf" else {}
    )
    vertex_radii = np.linalg.norm(read_mesh(tmp_path / "mesh.ply").vertices, axis=1)
    np.testing.assert_allclose(vertex_radii, radii[winner], rtol=1e-5)


def fused(gaussians, cameras, pictures):
    """Fusion by normals that are not smoothed: the lump is ten pixels wide."""
    return tsdf(lambda depth, _, camera: depth_normals(depth, camera))(gaussians, cameras, pictures)


LUMP = np.array([0.0, 0.0, 1.6])  # Its middle, above the ball; its radius is 0.35.


@pytest.fixture(scope="module")
def lumpy(ball, tmp_path_factory):
    """Run folders of the ball with a smaller one floating above it, which masks hide in one of the two."""
    as_lump = {"means": 0.35 * ball.gaussians.means + jnp.asarray(LUMP[None], jnp.float32),
               "log_scales": ball.gaussians.log_scales + jnp.float32(np.log(0.35))}  # fmt: skip
    lump = take(Gaussians(**{**ball.gaussians.__dict__, **as_lump}), np.arange(1, 2000, 4))
    both = jax.tree.map(lambda a, b: jnp.concatenate([a[np.arange(2000) % 4 != 0], b]), ball.gaussians, lump)
    lump_pictures = gallery.pictures(lump, ball.cameras, np.zeros(3))
    folders = {}
    for name in ("masked", "unmasked"):
        folders[name] = tmp_path_factory.mktemp(name)
        write_gaussians(folders[name] / "gaussians.ply", both)
        json_files.write(folders[name] / "config.json", {"background": "black"})
    frames, count = [], 0
    for index, (camera, picture) in enumerate(zip(ball.cameras, lump_pictures, strict=True)):
        hidden = ndimage.binary_dilation(picture.alphas > 0, iterations=1)
        count += hidden.sum()
        pixels = Pixels(np.zeros((*hidden.shape, 3), np.uint8), None, np.where(hidden, 0, 255).astype(np.uint8))
        frames.append(frame_of(f"{index}.png", camera.viewmat, camera.K, pixels))
    assert 500 < count < 0.1 * len(frames) * hidden.size
    write_views(folders["masked"], tuple(frames))
    write_views(folders["unmasked"], tuple(frame_of(f.name, f.viewmat, f.K, Pixels(f.pixels().image)) for f in frames))
    return folders


def test_where_photos_are_masked_or_floaters_hang_no_triangle_grows(lumpy, tmp_path, monkeypatch):
    """Here all of the lump is taken for floaters; `tests/gsjax/rendering/test_outliers.py` has what they are."""

    def are_floaters(gaussians, views):
        assert [(view.depth.shape, bool(view.depth.any())) for view in views] == 10 * [((60, 64), True)]
        return np.linalg.norm(np.asarray(gaussians.means) - LUMP, axis=1) < 0.5

    def mesh_counts(name, **options):
        report = mesh(lumpy[name], tmp_path / "mesh.ply", method=fused, photo_refine=False, **options)
        vertices = read_mesh(tmp_path / "mesh.ply").vertices
        assert report["method"] == "fused"
        assert np.sum(np.linalg.norm(vertices, axis=1) < 1.15) > 500, "the ball is there"
        return report["floaters"], int(np.sum(np.linalg.norm(vertices - LUMP, axis=1) < 0.5))

    monkeypatch.setattr(mesh_views, "are_floaters", are_floaters)
    assert mesh_counts("unmasked") == (500, 0)
    assert mesh_counts("masked", keep_floaters=True) == (None, 0)
    floaters, near_lump = mesh_counts("unmasked", keep_floaters=True)
    assert floaters is None
    assert near_lump > 50


def test_stereo_depth_is_of_the_training_view_of_its_name(lumpy, tmp_path, monkeypatch, capsys):
    """The ball's photos are black: instead, three of its ten views are of photos with stereo depth.

    A run that stereo supervised has maps of its own, and compares nothing.
    """
    result = open_result(lumpy["unmasked"])
    result = replace(result, held_out=tuple(index == 4 for index in range(10)))
    stereo = {f"{n}.png": StereoMap(np.full((2, 2), n, np.float32), np.zeros((2, 2, 3), np.int8)) for n in (2, 5, 9)}

    def depths(data, most):
        assert data == "of the photos" and most == 100
        return SimpleNamespace(line="3 of 9 photos")

    monkeypatch.setattr(mesh_views, "depths_of_photos", depths)
    monkeypatch.setattr(mesh_views, "stereo_maps", lambda _: stereo)
    views = partial(mesh_views.MeshViews, with_owners=False)
    assert {index: depth[0, 0] for index, depth in views(result, "of the photos").stereo.items()} == {2: 2, 4: 5, 8: 9}
    assert capsys.readouterr().err == "mesh: multi-view consistent depth: 3 of 9 photos\n"
    assert views(result, None).stereo == {} and views(result, None).stereo_counts
    run = shutil.copytree(lumpy["unmasked"], tmp_path / "run")
    write_stereo_maps(run, {"3.png": stereo["5.png"]})
    supervised = views(open_result(run), None)
    assert list(supervised.stereo) == [3] and not supervised.stereo_counts
    np.testing.assert_array_equal(supervised.stereo[3], stereo["5.png"].depth)


def test_pictures_that_memory_does_not_hold_are_rendered_again_and_are_the_same(lumpy, monkeypatch):
    result = open_result(lumpy["masked"])
    views = [mesh_views.MeshViews(result, None, with_owners=True) for _ in range(2)]
    stored = list(views[0].pictures([2, 5]))
    monkeypatch.setattr(mesh_views, "free_memory", lambda: 1000)
    again = list(views[1].pictures([2, 5]))
    for ours, theirs in zip(stored, again, strict=True):
        np.testing.assert_allclose(ours.colors, theirs.colors, atol=0.5 / 255 + 1e-6)
        for name in ("depth", "alphas", "owners"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    for ours, theirs in zip(views[0].rendered, views[1].rendered, strict=True):
        np.testing.assert_array_equal(ours.depth, theirs.depth)
    assert views[0].spread(4) == [0, 3, 6, 9] and views[0].spread(20) == list(range(10))


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"method": "nurbs"}, "method=nurbs is none of auto, poisson, tsdf"),
        ({"background_bounds": [0, 0, 0, 1, 1, 1]}, "background_bounds needs bounds"),
        ({"bounds": [0, 0, 0, 1, 1, float("inf")]}, "bounds 0 0 0 1 1 inf: not all of its sides are finite"),
        ({"cell": 1e-9, "method": "tsdf"}, "cell=1e-09: makes "),
        ({"points": 10**13}, "points=10000000000000 takes 2.24e"),
        ({"bounds": [5, 5, 5, 6, 6, 6]}, "holds none of 2000 Gaussians, which span"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_what_cannot_be_done_is_one_line_and_nothing_is_written(file, tmp_path, options, fault):
    with pytest.raises(InputError, match=fault) as caught:
        mesh(file, tmp_path / "mesh.ply", **options)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "mesh.ply").exists()
