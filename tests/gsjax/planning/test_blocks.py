import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.planning.blocks import MARGIN, cut, directions, photos_of

RNG = np.random.default_rng(0)
STREET = np.stack([np.linspace(0, 100, 61), RNG.uniform(-2, 2, 61)], axis=1)
SQUARE = RNG.uniform(0, 1, (200, 2)) * (30, 20)


@pytest.mark.parametrize("count", [1, 2, 5])
@pytest.mark.parametrize("places", [STREET, SQUARE])
def test_cells_fill_space_once_and_have_as_many_cameras_each(places, count):
    cells = cut(places, count)
    assert len(cells) == count
    anywhere = RNG.uniform(-1e4, 1e4, (500, 2))
    for points in (anywhere, places):
        assert (np.sum([cell.holds(points) for cell in cells], axis=0) == 1).all()
    counts = [cell.holds(places).sum() for cell in cells]
    assert max(counts) - min(counts) <= 2 + np.log2(count)


def test_cells_lie_along_what_cameras_are_spread_along_most():
    turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    centers = np.column_stack([STREET, RNG.normal(size=61) * 0.01]) @ turn.T + 5
    along = directions(centers)
    np.testing.assert_allclose(np.abs(along @ turn[:, :2]), np.eye(2), atol=1e-2)


def test_a_block_has_the_photos_of_its_margin_and_those_that_see_enough_of_it():
    first, _ = cut(STREET, 2)
    border, side = first.high[0], STREET[:, 0][first.holds(STREET)].max()
    nothing = [np.empty((0, 2))] * len(STREET)
    near = STREET[:, 0] < border + MARGIN * side
    np.testing.assert_array_equal(photos_of(first, STREET, nothing), near)
    far = int(np.argmax(STREET[:, 0]))
    sightings = list(nothing)
    sightings[far] = np.array([[10.0, 0], [20, 0], [90, 0], [95, 0]])
    assert photos_of(first, STREET, sightings)[far]
    sightings[far] = sightings[far][1:]
    sightings[far] = np.concatenate([sightings[far], [[99.0, 0]]])
    assert not photos_of(first, STREET, sightings)[far], "a quarter is too little"


def test_cameras_at_fewer_places_than_blocks_are_refused():
    with pytest.raises(InputError, match="^blocks=3: the cameras are at 2 places$"):
        cut(np.array([[0.0, 0], [1, 0], [1, 0]]), 3)
