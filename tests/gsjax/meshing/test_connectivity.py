import numpy as np
import pytest
from meshes import mesh_of, square, tetrahedron

from gsjax.meshing.connectivity import border, boundary_loops, edge_table, face_components, topology
from gsjax.scene.meshes import Mesh


def test_a_tetrahedron_is_closed_and_faces_outwards():
    report = topology(tetrahedron())
    assert (report["components"], report["boundary_loops"], report["boundary_length"], report["largest_hole"]) == (
        1,
        0,
        0,
        0,
    )
    assert report["watertight"] and report["oriented"] and not report["inside_out"]
    mesh = tetrahedron()
    turned = topology(Mesh(mesh.vertices, mesh.faces[:, ::-1].copy(), mesh.colors))
    assert turned["inside_out"] and turned["oriented"]
    faces = mesh.faces.copy()
    faces[0] = faces[0, ::-1]
    assert not topology(Mesh(mesh.vertices, faces, mesh.colors))["oriented"]


def test_holes_are_loops_with_lengths_and_those_that_touch_in_a_corner_are_one():
    mesh = square(8, without={(2, 2), (5, 4), (6, 4)})
    np.testing.assert_allclose(boundary_loops(mesh, edge_table(mesh.faces)), [32, 6, 4])
    report = topology(mesh)
    assert (report["boundary_loops"], report["boundary_length"], report["largest_hole"]) == (3, 42, 32)
    assert not report["watertight"]
    touching = square(6, without={(2, 2), (3, 3)})
    np.testing.assert_allclose(boundary_loops(touching, edge_table(touching.faces)), [24, 8])


def test_the_border_is_the_vertices_at_which_a_mesh_ends():
    vertices = border(square(5, without={(2, 2)}))
    rim = [(x, y, 0) for x in range(6) for y in range(6) if x in (0, 5) or y in (0, 5)]
    assert set(map(tuple, vertices.tolist())) == {*rim, (2, 2, 0), (3, 2, 0), (2, 3, 0), (3, 3, 0)}
    assert border(tetrahedron()).shape == (0, 3)


def test_pieces_connect_through_edges_not_corners():
    mesh = mesh_of(np.eye(5, 3), [[0, 1, 2], [2, 3, 4]])
    assert face_components(mesh.faces, edge_table(mesh.faces))[1].tolist() == [1, 1]
    far = square(3)
    both = mesh_of(np.r_[far.vertices, far.vertices[:3] + 9], np.r_[far.faces, [[16, 17, 18]]])
    assert topology(both)["components"] == 2
    assert topology(both)["largest_component_share"] == pytest.approx(18 / 19)
