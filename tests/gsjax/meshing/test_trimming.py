import numpy as np
import pytest

from gsjax.meshing.trimming import Support, adaptive, at_quantile


def support(distances, densities, edges=None):
    """Vertices along a line, unless `edges` says otherwise."""
    line = np.arange(len(distances))
    edges = np.stack([line[:-1], line[1:]], axis=1) if edges is None else np.array(edges)
    return Support(np.array(distances, float), np.array(densities, float), edges, near=1.0, far=2.0)


def test_where_all_is_supported_nothing_is_cut():
    rng = np.random.default_rng(0)
    cut = adaptive(support(rng.uniform(0, 1, 1000), rng.uniform(0, 9, 1000)))
    assert not cut.vertices.any()
    assert cut.quantile == 0


def test_thin_vertices_go_where_they_lead_to_far_ones():
    sound = [0.5] * 100
    # 100 is thin and 101 is not; 102 to 104 are a thin patch that ends in a far vertex, 105 is far and dense.
    distances = [*sound, 1.5, 1.5, 1.5, 1.5, 2.5, 2.5]
    densities = [*np.linspace(5, 9, 100), 2.0, 6.0, 2.0, 2.0, 2.0, 6.0]
    cut = adaptive(support(distances, densities))
    np.testing.assert_array_equal(np.flatnonzero(cut.vertices), [102, 103, 104, 105])
    assert cut.quantile == pytest.approx(2 / 106)


def test_a_small_hole_is_bridged():
    distances, densities = [*[0.5] * 50, 1.5, 1.9, 1.5, *[0.5] * 50], [*[5.0] * 50, 1, 1, 1, *[5.0] * 50]
    assert not adaptive(support(distances, densities)).vertices.any()


def test_the_density_has_no_unit():
    rng = np.random.default_rng(0)
    distances, densities = rng.uniform(0, 3, 1000), rng.uniform(0, 9, 1000)
    np.testing.assert_array_equal(
        adaptive(support(distances, densities)).vertices, adaptive(support(distances, 7 + 3 * densities)).vertices
    )


def test_where_nothing_is_near_only_the_far_goes():
    cut = adaptive(support([1.5, 2.5], [1, 1]))
    np.testing.assert_array_equal(cut.vertices, [False, True])


@pytest.mark.parametrize(("quantile", "left"), [(0.0, 100), (0.1, 90), (0.5, 50)])
def test_a_given_quantile_cuts_that_share(quantile, left):
    cut = at_quantile(quantile)(support(np.zeros(100), np.random.default_rng(0).permutation(100)))
    assert np.sum(~cut.vertices) == left
    assert cut.quantile == quantile
