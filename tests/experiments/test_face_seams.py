"""A room of known walls, and borders of faces that show by a known step."""

import numpy as np
import pytest
from tolerances import assert_close

WIDTH, STEP = 64, 10.0


@pytest.fixture
def room(scripts):
    return scripts("made_room")


def test_rays_meet_the_nearest_wall(room):
    viewmat = np.eye(4)
    viewmat[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]  # looks along x
    viewmat[:3, 3] = -viewmat[:3, :3] @ [0.0, 0.0, 1.0]
    rays = np.array([[0.0, 0, 1], [0, 0, -2], [0, 1, 0], [0, -1, 0], [1, 0, 0]])
    seen = room.look_along(viewmat, rays, np.zeros((len(room.BOXES), 6, room.TEXELS, room.TEXELS, 3), np.float32))
    assert_close(seen.distances, np.array([3.0, 1.5, 1.0, 1.8, 2.5]))


def test_a_step_between_faces_is_told_from_one_that_is_none(scripts, room):
    seams, lens = scripts("face_seams"), room.room_lens("panorama", WIDTH)
    faces = seams.cube_faces(room.pixel_rays(lens))
    assert set(faces.ravel()) == set(range(6))
    assert faces[WIDTH // 4, WIDTH // 2] == 0 and faces[0, 0] == 4  # ahead, and up
    found = seams.jumps(STEP * (faces == 0)[..., None], lens)
    assert_close(np.unique(found["trained"]), np.array([0.0, STEP]))  # other faces border on each other as well
    assert (found["turned"] == 0).all() and (found["within"] == 0).all() and len(found["within"]) > 100


def test_what_is_not_drawn_has_no_errors_to_compare(scripts, room):
    seams, lens = scripts("face_seams"), room.room_lens("fisheye", WIDTH)
    nothing = seams.jumps(np.full((WIDTH, WIDTH, 1), np.nan), lens)
    assert not any(len(jump) for jump in nothing.values())
