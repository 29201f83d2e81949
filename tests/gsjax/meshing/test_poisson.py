import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.meshing import poisson
from gsjax.meshing.poisson import Support, adaptive, at_quantile
from gsjax.scene.meshes import signed_volume


def sphere(count, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points, np.round((points + 1) * 127.5).astype(np.uint8)


def test_sphere_from_its_own_points_and_a_quantile_takes_its_share_of_the_vertices():
    points, colors = sphere(5000)
    mesh, report = poisson.reconstruct(points, points, colors, depth=6)
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1).max() < 0.02
    assert signed_volume(mesh) == pytest.approx(4 / 3 * np.pi, rel=0.02)
    expected = (mesh.vertices + 1) * 127.5
    assert np.median(np.abs(mesh.colors - expected)) < 8
    assert [report[name] for name in ("points_used", "depth", "trim_quantile")] == [5000, 6, 0.0]
    trimmed, report = poisson.reconstruct(points, points, colors, depth=6, trim=at_quantile(0.1))
    assert trimmed.num_vertices == pytest.approx(0.9 * mesh.num_vertices, rel=0.02)
    assert report["trim_quantile"] == 0.1


def test_a_half_sphere_is_not_closed_by_guesswork(monkeypatch):
    points, colors = sphere(6000)
    upper = points[:, 2] > 0
    half = points[upper], points[upper], colors[upper]
    mesh, report = poisson.reconstruct(*half, depth=6)
    assert mesh.vertices[:, 2].min() > -0.15
    assert report["trim_quantile"] > 0
    monkeypatch.setattr(poisson, "TRIM_CELLS", 300)
    closed, _ = poisson.reconstruct(*half, depth=6, trim=at_quantile(0))
    assert closed.vertices[:, 2].min() < mesh.vertices[:, 2].min() - 0.1


def test_a_far_stray_is_not_meshed():
    points, colors = sphere(5000)
    points, normals = np.vstack([points, [[60.0, 0, 0]]]), np.vstack([points, [[1.0, 0, 0]]])
    mesh, report = poisson.reconstruct(points, normals, np.vstack([colors, [[0, 0, 0]]]), depth=6)
    assert np.abs(mesh.vertices).max() < 1.1
    assert mesh.num_faces > 2000, "one cell would be as long as the ball"
    assert report["points_used"] == 5000


def test_the_octree_has_cells_of_the_size_asked_for():
    for cell in np.geomspace(3.3 / 2**10, 3.3 / 2**6, 9):
        depth, scale = poisson.octree_for_cell(3.0, cell, 1.1)
        assert 3.0 * scale / 2**depth == pytest.approx(cell)
        assert 6 <= depth <= 10 and 1.1 <= scale <= 2.2
    assert poisson.octree_for_cell(3.0, 0.0, 1.1) == (10, 1.1)
    assert poisson.octree_for_cell(3.0, 50.0, 1.1) == (6, 2.2)
    points, colors = sphere(3000)
    _, report = poisson.reconstruct(points, points, colors, smallest_cell=0.05)
    assert report["cell"] == pytest.approx(max(0.05, 2 * poisson.spacing(points)))


def test_too_few_points_are_refused():
    points, colors = sphere(50)
    with pytest.raises(InputError, match="50 surface points"):
        poisson.reconstruct(points, points, colors)


def support(distances, densities):
    """Vertices along a line."""
    line = np.arange(len(distances))
    edges = np.stack([line[:-1], line[1:]], axis=1)
    return Support(np.array(distances, float), np.array(densities, float), edges, near=1.0, far=2.0)


def test_where_all_is_supported_nothing_is_cut_and_a_small_hole_is_bridged():
    rng = np.random.default_rng(0)
    assert not adaptive(support(rng.uniform(0, 1, 1000), rng.uniform(0, 9, 1000))).vertices.any()
    distances, densities = [*[0.5] * 50, 1.5, 1.9, 1.5, *[0.5] * 50], [*[5.0] * 50, 1, 1, 1, *[5.0] * 50]
    assert not adaptive(support(distances, densities)).vertices.any()


def test_thin_vertices_go_where_they_lead_to_far_ones():
    sound = [0.5] * 100
    # 100 is thin and 101 is not; 102 to 104 are a thin patch that ends in a far vertex, 105 is far and dense.
    distances = [*sound, 1.5, 1.5, 1.5, 1.5, 2.5, 2.5]
    densities = [*np.linspace(5, 9, 100), 2.0, 6.0, 2.0, 2.0, 2.0, 6.0]
    cut = adaptive(support(distances, densities))
    np.testing.assert_array_equal(np.flatnonzero(cut.vertices), [102, 103, 104, 105])
    assert cut.quantile == pytest.approx(2 / 106)
