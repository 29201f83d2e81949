import numpy as np
import pytest
from meshes import mesh_of, square, tetrahedron

from gsjax.errors import InputError
from gsjax.meshing.cleaning import clean, concatenate_meshes
from gsjax.meshing.connectivity import edge_table, face_components, topology
from gsjax.scene.meshes import Mesh


def wavy_square(count):
    line = np.linspace(0, 1, count)
    return square(count - 1, 0, 1, height=0.02 * np.sin(9 * line)[None])


def test_bad_faces_go_and_are_counted():
    mesh = tetrahedron()
    vertices = np.vstack([mesh.vertices, [[0.5, 0, 0]]])  # On the edge 0-1: a triangle without area.
    faces = np.vstack([mesh.faces, [[0, 0, 1], [0, 4, 1], [2, 1, 0], [0, 1, 2]]])
    result, report = clean(mesh_of(vertices, faces))
    assert report["degenerate_faces"] == 2
    assert report["duplicate_faces"] == 2
    assert topology(result)["watertight"]
    assert result.num_vertices == 4


def test_small_pieces_go_by_their_share():
    both = concatenate_meshes([wavy_square(20), tetrahedron((5.0, 0, 0))])
    assert sorted(face_components(both.faces, edge_table(both.faces))[1]) == [4, 722]
    result, report = clean(both, min_component_share=0.01)
    assert (report["small_components"], report["small_component_faces"]) == (1, 4)
    assert topology(result)["components"] == 1
    assert result.num_vertices == 400
    lenient_result, report = clean(both, min_component_share=0.001)
    assert not any(report.values())
    assert lenient_result.num_faces == 726


def test_decimation_keeps_shape_and_colour():
    whole = wavy_square(40)
    result, report = clean(whole, max_faces=500)
    assert result.num_faces <= 500
    assert report["decimated_faces"] == whole.num_faces - result.num_faces
    assert np.all(result.colors == 90)
    np.testing.assert_allclose(np.ptp(result.vertices, axis=0), np.ptp(whole.vertices, axis=0), atol=0.01)
    heights = 0.02 * np.sin(9 * result.vertices[:, 0])
    assert np.abs(result.vertices[:, 2] - heights).max() < 0.004


@pytest.mark.parametrize("faces", [np.zeros((0, 3), np.int32), np.array([[0, 0, 1]], np.int32)])
def test_nothing_left_is_one_line(faces):
    with pytest.raises(InputError, match="left after cleaning"):
        clean(mesh_of(np.eye(3), faces))


def test_the_first_of_equal_vertices_stays_with_its_colour():
    vertices = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    colors = np.arange(18, dtype=np.uint8).reshape(6, 3)
    result, _ = clean(Mesh(vertices, np.int32([[0, 1, 2], [3, 4, 5]]), colors))
    np.testing.assert_array_equal(result.vertices, vertices[[0, 1, 2, 4]])
    np.testing.assert_array_equal(result.colors, colors[[0, 1, 2, 4]])
    np.testing.assert_array_equal(result.faces, [[0, 1, 2], [1, 3, 2]])
