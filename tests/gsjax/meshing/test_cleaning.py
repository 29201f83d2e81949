import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.mesh import Mesh, signed_volume
from gsjax.meshing.cleaning import clean, edge_table, face_components


def mesh_of(vertices, faces):
    vertices = np.asarray(vertices, np.float32)
    return Mesh(vertices, np.asarray(faces, np.int32), np.full((len(vertices), 3), 90, np.uint8))


def tetrahedron(offset=(0.0, 0.0, 0.0)):
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) + offset
    return mesh_of(vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def joined(*meshes):
    starts = np.cumsum([0, *(m.num_vertices for m in meshes[:-1])])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + start for m, start in zip(meshes, starts, strict=True)]).astype(np.int32),
        np.concatenate([m.colors for m in meshes]),
    )


def wavy_square(count):
    x, y = np.meshgrid(np.linspace(0, 1, count), np.linspace(0, 1, count))
    vertices = np.stack([x.ravel(), y.ravel(), 0.02 * np.sin(9 * x.ravel())], axis=-1)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = np.r_[
        np.stack([corner, corner + 1, corner + count], -1),
        np.stack([corner + 1, corner + count + 1, corner + count], -1),
    ]
    return mesh_of(vertices, faces)


def test_a_clean_mesh_stays():
    mesh, report = clean(tetrahedron())
    assert (report.vertices, report.faces, report.components) == (4, 4, 1)
    assert report.watertight and report.oriented and not report.inside_out
    assert report.boundary_length == 0
    assert report.degenerate_faces == report.duplicate_faces == report.non_manifold_faces == 0
    assert signed_volume(mesh) == pytest.approx(1 / 6)


def test_inside_out_is_reported():
    mesh = tetrahedron()
    _, report = clean(Mesh(mesh.vertices, mesh.faces[:, ::-1].copy(), mesh.colors))
    assert report.watertight and report.oriented and report.inside_out


def test_one_turned_face_is_not_oriented():
    mesh = tetrahedron()
    faces = mesh.faces.copy()
    faces[0] = faces[0, ::-1]
    assert not clean(Mesh(mesh.vertices, faces, mesh.colors))[1].oriented


def test_boundary_length_of_an_open_tetrahedron():
    mesh = tetrahedron()
    _, report = clean(Mesh(mesh.vertices, mesh.faces[:3], mesh.colors))
    assert not report.watertight
    assert report.boundary_length == pytest.approx(3 * np.sqrt(2))


def test_bad_faces_go_and_are_counted():
    mesh = tetrahedron()
    vertices = np.vstack([mesh.vertices, [[0.5, 0, 0]]])  # On the edge 0-1: a triangle without area.
    faces = np.vstack([mesh.faces, [[0, 0, 1], [0, 4, 1], [2, 1, 0], [0, 1, 2]]])
    result, report = clean(mesh_of(vertices, faces))
    assert report.degenerate_faces == 2
    assert report.duplicate_faces == 2
    assert report.watertight
    assert result.num_vertices == 4


def test_vertices_at_one_place_are_merged():
    mesh = tetrahedron()
    soup = mesh_of(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(12).reshape(4, 3))
    result, report = clean(soup)
    assert (result.num_vertices, result.num_faces) == (4, 4)
    assert report.watertight


def test_a_fin_on_an_edge_goes():
    mesh = tetrahedron()
    fin = np.vstack([mesh.vertices, [[0.5, -0.1, -0.1]]])
    result, report = clean(mesh_of(fin, np.vstack([mesh.faces, [[0, 1, 4]]])))
    assert report.non_manifold_faces == 1
    assert report.watertight
    assert edge_table(result.faces).faces.max() == 2


def test_small_pieces_go_by_their_share():
    square, crumb = wavy_square(20), tetrahedron((5.0, 0, 0))
    both = joined(square, crumb)
    assert sorted(face_components(both)[1]) == [4, 722]
    result, report = clean(both, min_component_share=0.01)
    assert (report.small_components, report.small_component_faces, report.components) == (1, 4, 1)
    assert result.num_vertices == 400
    kept, report = clean(both, min_component_share=0.001)
    assert (report.small_components, report.components) == (0, 2)
    assert kept.num_faces == 726


def test_pieces_that_touch_in_one_vertex_are_two():
    labels, sizes = face_components(mesh_of(np.eye(5, 3), [[0, 1, 2], [2, 3, 4]]))
    assert labels[0] != labels[1]
    assert sizes.tolist() == [1, 1]


def test_decimation_keeps_shape_and_colour():
    square = wavy_square(40)
    result, report = clean(square, max_faces=500)
    assert result.num_faces <= 500
    assert report.decimated_faces == square.num_faces - result.num_faces
    assert np.all(result.colors == 90)
    np.testing.assert_allclose(result.vertices.min(0), square.vertices.min(0), atol=0.01)
    np.testing.assert_allclose(result.vertices.max(0), square.vertices.max(0), atol=0.01)
    heights = 0.02 * np.sin(9 * result.vertices[:, 0])
    assert np.abs(result.vertices[:, 2] - heights).max() < 0.004


def test_cleaning_twice_changes_nothing():
    once, _ = clean(joined(wavy_square(10), tetrahedron((3.0, 0, 0))), min_component_share=0.0)
    twice, report = clean(once, min_component_share=0.0)
    np.testing.assert_array_equal(once.vertices, twice.vertices)
    np.testing.assert_array_equal(once.faces, twice.faces)
    assert report.small_components == report.degenerate_faces == report.duplicate_faces == 0


@pytest.mark.parametrize("faces", [np.zeros((0, 3), np.int32), np.array([[0, 0, 1]], np.int32)])
def test_nothing_left_is_one_line(faces):
    with pytest.raises(InputError, match="left after cleaning"):
        clean(mesh_of(np.eye(3), faces))
