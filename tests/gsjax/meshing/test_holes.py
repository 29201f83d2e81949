"""Holes of a flat sheet: one where views show the sheet, a window that they look through, and one that nobody saw."""

from dataclasses import replace

import numpy as np
from meshes import square

from gsjax.meshing.connectivity import topology
from gsjax.meshing.holes import fill_holes
from gsjax.rendering.coarse_depths import CoarseDepth
from gsjax.scene.cameras import Camera
from gsjax.scene.meshes import Mesh, face_area_vectors

SIDE, AWAY = 40, 40.0
HOLES = {"shown": (6, 6), "window": (24, 6), "unseen": (6, 24)}  # Lowest cells; each is three cells wide.


def sheet(without=("shown", "window", "unseen")):
    """`SIDE` by `SIDE` cells at z = 0, facing +z, less some squares of three by three cells."""
    gone = {(i + a, j + b) for i, j in (HOLES[name] for name in without) for a in range(3) for b in range(3)}
    return square(SIDE, without=gone)


def views(count=3):
    """From above, a pixel a cell: the sheet at `AWAY`, the window twice as far, and nothing of what is unseen."""
    viewmat = np.diag([1.0, -1, -1, 1]).astype(np.float32)
    viewmat[:3, 3] = -SIDE / 2, SIDE / 2, AWAY
    K = np.array([[AWAY, 0, SIDE / 2], [0, AWAY, SIDE / 2], [0, 0, 1]], np.float32)
    depth = np.full((SIDE, SIDE), AWAY, np.float32)
    for name, value in (("window", 2 * AWAY), ("unseen", 0)):
        i, j = HOLES[name]
        depth[SIDE - j - 3 : SIDE - j, i : i + 3] = value
    return [CoarseDepth(Camera(viewmat, K, SIDE, SIDE), depth)] * count


def test_a_hole_is_closed_where_views_show_a_surface():
    mesh = sheet()
    result, report = fill_holes(mesh, views())
    assert report == {"patches": 3, "closed": 1, "closed_faces": result.num_faces - mesh.num_faces}
    added = face_area_vectors(Mesh(mesh.vertices, result.faces[mesh.num_faces :], mesh.colors))
    np.testing.assert_allclose(added.sum(axis=0), [0, 0, 9], atol=1e-4)
    middles = mesh.vertices[result.faces[mesh.num_faces :]].mean(axis=1)[:, :2]
    assert ((middles > 6) & (middles < 9)).all()
    before, after = topology(mesh), topology(result)
    assert (before["boundary_loops"], after["boundary_loops"]) == (4, 3)
    assert after["oriented"]
    whole = sheet(())
    assert fill_holes(whole, views())[0] is whole


def test_a_torn_sheet_gets_no_edge_with_three_triangles():
    far_views = [view._replace(depth=np.full((SIDE, SIDE), AWAY, np.float32)) for view in views()]
    whole = sheet(())
    torn = replace(whole, faces=whole.faces[np.random.default_rng(1).random(whole.num_faces) > 0.4])
    result, report = fill_holes(torn, far_views)
    assert 0 < report["closed"] < report["patches"], "one of the patches has an edge that the sheet has"
    assert topology(torn)["oriented"] and topology(result)["oriented"]
    assert topology(result)["boundary_loops"] < topology(torn)["boundary_loops"]
