import numpy as np
import pytest
from meshes import square
from tolerances import assert_close

from gsjax.meshing import texture
from gsjax.meshing.atlas import Atlas, cells
from gsjax.meshing.cleaning import concatenate_meshes
from gsjax.meshing.texel_points import texels_of
from gsjax.meshing.texture import composite_views, texture_mesh
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera, look_at
from gsjax.scene.meshes import Mesh

WIDTH, HEIGHT, FOCAL = 96, 80, 90.0
UNSEEN = (1, 2, 3)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    """So that the squares below take several."""
    monkeypatch.setattr(texture, "TEXELS_AT_ONCE", 1000)


def wall(z=0.0, half=1.0, per_side=2) -> Mesh:
    """A square at height z that faces up, its vertices coloured `UNSEEN`."""
    return square(per_side, -half, half, height=z, color=UNSEEN)


def flat_layout(mesh: Mesh, size: int) -> Atlas:
    """The square as one chart that fills the texture."""
    span = np.ptp(mesh.vertices[:, :2], axis=0)
    uvs = ((mesh.vertices[:, :2] - mesh.vertices[:, :2].min(0)) / span).astype(np.float32)
    return Atlas(uvs, np.arange(len(uvs), dtype=np.int32), mesh.faces, size, 1)


def camera(eye, target=(0.0, 0, 0)) -> Camera:
    viewmat = look_at(np.asarray(eye, float), np.asarray(target, float), np.array([0.1, 1.0, 0.2])).astype(np.float32)
    K = np.array([[FOCAL, 0, 47.3], [0, 1.1 * FOCAL, 40.9], [0, 0, 1]], np.float32)
    return Camera(viewmat, K, WIDTH, HEIGHT)


def on_plane(view: Camera, z: float):
    """`[H, W, 2]` where the pixels' rays meet a horizontal plane, and `[H, W]` camera z there."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(x - view.K[0, 2]) / view.K[0, 0], (y - view.K[1, 2]) / view.K[1, 1], np.ones_like(x)], -1)
    rays = rays @ view.viewmat[:3, :3].astype(float)
    eye = -view.viewmat[:3, :3].astype(float).T @ view.viewmat[:3, 3]
    depth = (z - eye[2]) / rays[..., 2]
    return (eye + depth[..., None] * rays)[..., :2], depth.astype(np.float32)


def picture(colors, depth=None, alphas=None) -> Picture:
    colors = np.broadcast_to(np.asarray(colors, np.float32), (HEIGHT, WIDTH, 3))
    depth = np.zeros((HEIGHT, WIDTH), np.float32) if depth is None else depth
    alphas = np.ones((HEIGHT, WIDTH), np.float32) if alphas is None else alphas
    return Picture(colors * alphas[..., None], depth, alphas, np.zeros((HEIGHT, WIDTH), np.int32))


def pattern(xy):
    """Smooth colours of a plane, 0.1 to 0.9, six waves across."""
    waves = [np.sin(9 * xy[..., 0]), np.cos(9 * xy[..., 1]), np.sin(6 * (xy[..., 0] + xy[..., 1]))]
    return 0.5 + 0.4 * np.stack(waves, axis=-1)


def seen_of(mesh, views, pictures, size=40):
    """Texels of the square's own layout, their colours, and whether they are seen."""
    texels = texels_of(mesh, flat_layout(mesh, size))
    return texels, *composite_views(mesh, texels, views, pictures)


def test_a_pattern_on_a_plane_comes_back_from_views_at_an_angle():
    mesh = wall(per_side=4)
    views = [camera(eye) for eye in ((1, 0.5, 2.5), (-1, 1, 2.2), (0, -1.5, 2.4), (0.3, 0.2, 2.0))]
    plane_maps = [on_plane(view, 0.0) for view in views]
    pictures = [picture(pattern(xy), depth) for xy, depth in plane_maps]
    textured, report = texture_mesh(mesh, views, iter(pictures), size=128, unwrap=cells)
    texels = texels_of(mesh, textured.atlas)
    texel_colors = textured.texture.reshape(-1, 3)[texels.where] / 255
    is_seen = np.any(textured.texture.reshape(-1, 3)[texels.where] != UNSEEN, axis=-1)
    assert report["seen_share"] == pytest.approx(is_seen.mean(), abs=1e-3)
    assert report["texels"] == len(texels.where)
    inner = np.abs(texels.points[:, :2]).max(axis=1) < 0.9
    assert is_seen[inner].all()
    error = np.abs(texel_colors - pattern(texels.points[:, :2]))[inner]
    # A pixel is 0.025 wide: straight lines between pixels miss a wave by (9 * 0.025)^2 / 8 * 0.4 = 0.0025, and as much
    # along the slant; rounding to bytes adds 0.002.
    assert error.max() < 0.012
    assert error.mean() < 0.003


def test_a_hidden_wall_does_not_receive_the_colour_of_the_one_before_it():
    front, back = wall(z=1.0, half=0.4), wall(z=0.0, half=1.0)
    mesh = concatenate_meshes([front, back])
    views = [camera((0.4 * np.cos(a), 0.4 * np.sin(a), 3.0)) for a in (0.0, 1.3, 2.9, 4.4)]
    pictures = []
    for view in views:
        (near, near_depth), (_, far_depth) = on_plane(view, 1.0), on_plane(view, 0.0)
        is_front = np.abs(near).max(axis=-1) < 0.4
        depth = np.where(is_front, near_depth, far_depth)
        pictures.append(picture(np.where(is_front[..., None], [1.0, 0, 0], [0, 0, 1.0]), depth))
    texels = texels_of(mesh, cells(mesh, 256))
    colors, is_seen = composite_views(mesh, texels, views, pictures)
    on_back = texels.points[:, 2] < 0.5
    assert np.all(colors[is_seen & on_back] == [0, 0, 255]), "red bled onto the wall behind"
    assert np.all(colors[is_seen & ~on_back] == [255, 0, 0]), "blue bled onto the wall before"
    # The middle of the back wall is in no view's sight, its border in all: by similar triangles.
    radius = np.abs(texels.points[:, :2]).max(axis=1)
    assert not is_seen[on_back & (radius < 0.3)].any()
    assert is_seen[on_back & (radius > 0.85) & (radius < 0.95)].all()
    assert is_seen[~on_back & (radius < 0.3)].all()


def test_views_count_by_the_pixels_that_a_unit_of_surface_covers():
    mesh = wall(half=0.05)
    views = [camera((0, 0, 2.0)), camera((0, 0, 4.0)), camera((0, 3.0, 3.0))]
    colors = np.eye(3)
    _, texel_colors, is_seen = seen_of(mesh, views, [picture(color) for color in colors], size=9)
    weights = np.array([1 / 2**2, 1 / 4**2, np.sqrt(0.5) / 18])
    assert is_seen.reshape(9, 9)[4, 4]
    assert_close(
        texel_colors.reshape(9, 9, 3)[4, 4] / 255,
        weights / weights.sum(),
        rtol=0,
        atol=0.004,
        why="bytes, and a texel that is not quite in the middle",
    )


def test_pictures_that_do_not_show_the_surface_are_left_out():
    mesh, view = wall(), camera((0.2, 0.3, 3.0))
    depth = on_plane(view, 0.0)[1]
    assert not seen_of(mesh, [view], [picture([1, 0, 0], alphas=np.full_like(depth, 0.4))])[2].any(), "nothing much"
    assert not seen_of(mesh, [view], [picture([1, 0, 0], 0.8 * depth)])[2].any(), "haze floats before it"
    assert seen_of(mesh, [view], [picture([1, 0, 0], 0.97 * depth)])[2].any()


def test_beyond_the_picture_and_behind_the_camera_nothing_is_seen():
    mesh = wall(half=2.0)
    views = [camera((0, 0, 1.0)), camera((0, 0, 1.0), target=(0, 0, 2.0))]
    for view, is_turned in zip(views, (False, True), strict=True):
        texels, _, is_seen = seen_of(mesh, [view], [picture([1, 1, 1])], size=101)
        x, y, z = view.viewmat[:3, :3] @ texels.points.T + view.viewmat[:3, 3:]
        assert np.all(z < 0) == is_turned
        columns, rows = FOCAL * x / z + 47.3, 1.1 * FOCAL * y / z + 40.9
        inside = (z > 0) & (columns > 1) & (columns < WIDTH - 1) & (rows > 1) & (rows < HEIGHT - 1)
        np.testing.assert_array_equal(is_seen[inside], True)
        outside = (z < 0) | (columns < 0.4) | (columns > WIDTH - 0.4) | (rows < 0.4) | (rows > HEIGHT - 0.4)
        assert not is_seen[outside].any()


def test_what_shines_through_a_thin_wall_is_its_own_colour_but_not_at_its_rim():
    mesh, view = wall(half=0.4), camera((0.1, 0.2, 2.0))
    xy, depth = on_plane(view, 0.0)
    is_wall = np.abs(xy).max(axis=-1) < 0.4
    thin = picture([0.2, 0.4, 0.6], np.where(is_wall, depth, 0), np.where(is_wall, 0.75, 0).astype(np.float32))
    texels = texels_of(mesh, flat_layout(mesh, 40))
    colors, is_seen = composite_views(mesh, texels, [view], [thin], np.ones(3, np.float32))
    through = np.rint(255 * (0.75 * np.array([0.2, 0.4, 0.6]) + 0.25))
    inner = np.abs(texels.points[:, :2]).max(axis=1) < 0.3
    assert is_seen[inner].all() and np.abs(colors[inner] - through).max() <= 1
    straight, _ = composite_views(mesh, texels, [view], [thin])
    assert np.abs(straight[inner] - np.array([51, 102, 153])).max() <= 1, "where nothing is known of the background"
    rim = is_seen & (np.abs(texels.points[:, :2]).max(axis=1) > 0.38)
    to_straight, to_through = (np.abs(colors[rim] - each).mean() for each in ([51, 102, 153], through))
    assert to_straight < to_through, "beyond the rim lies the background itself"
