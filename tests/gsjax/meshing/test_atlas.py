import signal

import numpy as np
import pytest
from meshes import ball
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gsjax.errors import InputError
from gsjax.meshing import atlas as atlases
from gsjax.meshing.atlas import cells, charts, texel_corners, unwrap
from gsjax.meshing.texel_points import paint_texture, texels_of
from gsjax.scene.meshes import Mesh

SIZE = 256


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    """A bumpy ball of 1,280 triangles."""
    sphere = ball(3)
    bumps = 1 + 0.15 * np.sin(5 * sphere.vertices).sum(axis=1, keepdims=True)
    colors = np.random.default_rng(0).integers(0, 256, sphere.vertices.shape, dtype=np.uint8)
    return Mesh(sphere.vertices * bumps, sphere.faces, colors)


@pytest.fixture(scope="module", params=[charts, cells], ids=["charts", "cells"])
def laid_out(request, mesh):
    return request.param(mesh, SIZE)


def bilinear(image, x, y):
    """`image` at texel coordinates whose centres are at +0.5."""
    at = [y - 0.5, x - 0.5]
    return np.stack([ndimage.map_coordinates(image[..., k], at, order=1, mode="nearest") for k in range(3)], -1)


def charts_of(atlas):
    """The chart of every place: places are joined by triangles."""
    a, b = atlas.faces.ravel(), np.roll(atlas.faces, 1, axis=1).ravel()
    count = len(atlas.uvs)
    return connected_components(coo_array((np.ones(len(a)), (a, b)), (count, count)), directed=False)


def strictly_covered(corners):
    """How many triangles hold each texel's centre, a thousandth of a texel inside: by brute force."""
    count = np.zeros((SIZE, SIZE), int)
    for a, b, c in corners:
        low = np.floor(np.min([a, b, c], axis=0)).astype(int)
        high = np.ceil(np.max([a, b, c], axis=0)).astype(int)
        x, y = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
        sides = [
            ((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])) / max(np.linalg.norm(q - p), 1e-12)
            for p, q in ((a, b), (b, c), (c, a))
        ]
        inside = np.min(sides, axis=0) > 1e-3
        inside |= np.max(sides, axis=0) < -1e-3
        count[low[1] : high[1], low[0] : high[0]] += inside
    return count


def test_every_triangle_has_its_own_corners_in_the_square_and_no_two_overlap(mesh, laid_out):
    assert laid_out.size == SIZE
    np.testing.assert_array_equal(laid_out.vertices[laid_out.faces], mesh.faces)
    assert laid_out.uvs.min() >= 0
    assert laid_out.uvs.max() <= 1
    assert np.abs(atlases.doubled_areas(texel_corners(laid_out))).min() > 0
    assert strictly_covered(texel_corners(laid_out)).max() == 1


def test_texels_are_those_that_a_triangle_covers_and_show_its_points(mesh, laid_out):
    texels = texels_of(mesh, laid_out)
    counts = np.zeros(SIZE * SIZE, int)
    np.add.at(counts, texels.where, 1)
    assert counts.max() == 1, "a texel twice"
    assert np.all(counts.reshape(SIZE, SIZE)[strictly_covered(texel_corners(laid_out)) == 1] == 1)
    assert set(texels.faces) == set(range(mesh.num_faces)) or laid_out.num_charts < mesh.num_faces

    # The point's barycentrics, from three dimensions, lead back to the texel's centre.
    a, b, c = np.moveaxis(mesh.vertices.astype(np.float64)[mesh.faces[texels.faces]], 1, 0)
    edges = np.stack([b - a, c - a], axis=-1)
    weights = (np.linalg.pinv(edges) @ (texels.points - a)[..., None])[..., 0]
    weights = np.concatenate([1 - weights.sum(-1, keepdims=True), weights], axis=-1)
    assert weights.min() > -1e-4, "outside its triangle"
    np.testing.assert_allclose(np.einsum("mk,mkd->md", weights, np.stack([a, b, c], 1)), texels.points, atol=1e-6)
    centers = np.stack([texels.where % SIZE, texels.where // SIZE], axis=-1) + 0.5
    reached = np.einsum("mk,mkd->md", weights, texel_corners(laid_out)[texels.faces])
    assert np.quantile(np.abs(reached - centers), 0.99) < 1e-2
    assert np.abs(reached - centers).max() < 1.5  # a triangle that covers no centre has the one beneath its own

    colors = np.einsum("mk,mkd->md", weights, mesh.colors[mesh.faces[texels.faces]].astype(float))
    assert np.abs(colors - texels.colors).max() < 0.6


@pytest.mark.parametrize(("layout", "size"), [(charts, SIZE), (cells, 26 * 7 + 3)])
def test_bilinear_sampling_at_borders_reads_the_inner_colour_alone(mesh, layout, size):
    atlas = layout(mesh, size)
    texels = texels_of(mesh, atlas)
    _, labels = charts_of(atlas)
    palette = np.random.default_rng(1).integers(0, 256, (labels.max() + 1, 3))
    image = paint_texture(texels, palette[labels[atlas.faces[texels.faces, 0]]], size).astype(float)
    corners = texel_corners(atlas)
    weights = np.random.default_rng(2).dirichlet([0.3, 0.3, 0.3], (20, len(corners)))  # many near edges and corners
    for weight in [*weights, *np.eye(3)[:, None].repeat(len(corners), 1)]:
        x, y = np.einsum("fk,fkd->df", weight, corners)
        error = np.abs(bilinear(image, x, y) - palette[labels[atlas.faces[:, 0]]]).max(axis=-1)
        # A chart of one sliver may have no texel; every other point of the surface is pure. float32 places: 1e-2.
        assert np.mean(error > 1e-1) <= (0 if layout is cells else 2e-3)


def test_a_texture_that_is_too_small_says_what_it_takes(mesh):
    with pytest.raises(InputError, match=r"texture of 100 px has no room for 1280 triangles: it takes 104 px, .* 1250"):
        cells(mesh, 100)
    assert cells(mesh, 104).size == 104


def test_triangles_without_area_lie_on_a_painted_point(mesh):
    """Repeated corners, corners in a line, and two triangles that share nothing with the rest."""
    vertices = np.concatenate([mesh.vertices, [[0, 0, 9], [0, 0, 10], [0, 0, 11], [5, 0, 0], [5, 0, 0], [5, 1, 0]]])
    n = mesh.num_vertices
    extra = np.array([[0, 0, 1], [2, 3, 3], [n, n + 1, n + 2], [n + 3, n + 4, n + 5], [7, 7, 7]], np.int32)
    broken = Mesh(vertices.astype(np.float32), np.r_[mesh.faces, extra], np.r_[mesh.colors, np.zeros((6, 3), np.uint8)])
    atlas = charts(broken, SIZE)
    np.testing.assert_array_equal(atlas.vertices[atlas.faces], broken.faces)
    flat = texel_corners(atlas)[-len(extra) :]
    assert np.all(flat == flat[:, :1])
    texels = texels_of(broken, atlas)
    assert np.isfinite(texels.points).all()
    at = np.floor(flat[:, 0]).astype(int)
    near = ndimage.binary_dilation(np.isin(np.arange(SIZE * SIZE), texels.where).reshape(SIZE, SIZE), iterations=2)
    assert near[at[:, 1], at[:, 0]].all()


@pytest.mark.parametrize(
    "program", [f"import os; os.kill(os.getpid(), {int(signal.SIGSEGV)})", "pass"], ids=["crash", "nothing written"]
)
def test_where_xatlas_fails_there_are_cells(mesh, monkeypatch, tmp_path, program):
    (tmp_path / "xatlas_process.py").write_text(program)
    monkeypatch.setattr(atlases, "XATLAS_PROCESS", tmp_path / "xatlas_process.py")
    assert unwrap(mesh, SIZE).num_charts == mesh.num_faces
