"""Gaussians bound to the triangles of a mesh: vertices and a few numbers a Gaussian to means and covariances.

Every triangle carries 1, 3, 4 or 6 flat Gaussians at fixed barycentric places (SuGaR, section 4.2). Their means are
combinations of its corners, their normal is its normal, so whatever moves the vertices moves the Gaussians.
"""

from dataclasses import dataclass, field
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial.transform import Rotation

from gsjax.gaussians import DEAD_LOGIT, SH_C0, Gaussians, PixelFilter, rgb_to_sh
from gsjax.rendering import Drawable, drawable
from gsjax.scene.meshes import Mesh
from rasterizer.covariances import Matrix, Vector, components, cross, dot, matrix_rows
from rasterizer.tracing import walled

COLLAPSED = 1e-5  # Height over longest edge under which a triangle has no direction left in float32.


def _rotations_of(a: float, b: float, c: float) -> list[list[float]]:
    return [[a, b, c], [c, a, b], [b, c, a]]


_CENTER = [[1 / 3, 1 / 3, 1 / 3]]
LAYOUTS: dict[int, tuple[np.ndarray, float]] = {
    1: (np.array(_CENTER), 1 / (2 * 3**0.5)),
    3: (np.array(_rotations_of(1 / 2, 1 / 4, 1 / 4)), 1 / (2 * (3**0.5 + 1))),
    4: (np.array(_CENTER + _rotations_of(2 / 3, 1 / 6, 1 / 6)), 1 / (4 * 3**0.5)),
    6: (
        np.array(_rotations_of(2 / 3, 1 / 6, 1 / 6) + _rotations_of(1 / 6, 5 / 12, 5 / 12)),
        1 / (4 + 2 * 3**0.5),
    ),
}
"""Gaussians a triangle -> their barycentric coordinates `[n, 3]`, and first radius over the shortest edge (SuGaR)."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BoundGaussians:
    """G = n F Gaussians on F triangles, those of a triangle in a row; floats are float32 and free (unconstrained).

    `faces` is None where only the free parameters are meant: gradients and optimiser states.
    """

    vertices: Array  # [V, 3] world positions, scene units
    log_scales: Array  # [G, 2] natural log of the standard deviations in the plane, scene units
    rotations: Array  # [G, 2] (re, im) of a complex number of any length but zero: the turn in the plane
    logit_opacities: Array  # [G] log-odds of the opacity
    sh_dc: Array  # [G, 1, 3] degree-0 coefficients
    sh_rest: Array  # [G, (L+1)^2 - 1, 3] coefficients of degrees 1..L
    faces: Array | None  # [F, 3] int32 vertex ids, counter-clockwise seen from outside
    thickness: float = field(metadata={"static": True})  # standard deviation along the normal, scene units
    pixel_filter: PixelFilter = field(default="mip", metadata={"static": True})

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians, those of collapsed triangles included."""
        return self.log_scales.shape[0]

    @property
    def per_triangle(self) -> int:
        """Gaussians a triangle."""
        return self.num_gaussians // _faces(self).shape[0]


def bind(
    mesh: Mesh,
    *,
    per_triangle: int,
    thickness: float,
    sh_degree: int = 3,
    opacity: float = 0.9,
    pixel_filter: PixelFilter = "mip",
) -> BoundGaussians:
    """Round Gaussians on every triangle, on the device, as wide as the layout and the shortest edge allow.

    Args:
        mesh: Vertices, triangles, one at least, and the colours that the Gaussians start with.
        per_triangle: 1, 3, 4 or 6.
        thickness: Standard deviation along the normal, scene units, above 0.
        sh_degree: Degree of the harmonics, zero above the constant band.
        opacity: Of every Gaussian, between 0 and 1.
        pixel_filter: How they are to be drawn; the classic one bends the geometry (docs/meshes.md#refinement).
    """
    barycentric, radius = LAYOUTS[per_triangle]
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    shortest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=-1).min(axis=1)
    colors = np.einsum("nk,fkc->fnc", barycentric, mesh.colors[mesh.faces] / 255.0).reshape(-1, 1, 3)
    count = per_triangle * mesh.num_faces
    scales = np.repeat(np.maximum(radius * shortest, 1e-7), per_triangle)  # SuGaR's floor.
    return BoundGaussians(
        vertices=jnp.asarray(mesh.vertices, jnp.float32),
        log_scales=jnp.asarray(np.log(np.stack([scales, scales], axis=-1)), jnp.float32),
        rotations=jnp.asarray(np.tile([1.0, 0.0], (count, 1)), jnp.float32),
        logit_opacities=jnp.full(count, np.log(opacity / (1 - opacity)), jnp.float32),
        sh_dc=jnp.asarray(rgb_to_sh(colors), jnp.float32),
        sh_rest=jnp.zeros((count, (sh_degree + 1) ** 2 - 1, 3), jnp.float32),
        faces=jnp.asarray(mesh.faces, jnp.int32),
        thickness=float(thickness),
        pixel_filter=pixel_filter,
    )


def means(bound: BoundGaussians) -> Array:
    """`[G, 3]` world positions."""
    return _means(bound, _corners(bound))


def covariances(bound: BoundGaussians) -> Array:
    """`[G, 3, 3]` R diag(thickness, s_1, s_2)^2 R^T, world, scene units squared."""
    return _covariances(bound, _corners(bound))[0]


def axes(bound: BoundGaussians) -> Array:
    """`[G, 3, 3]` rotations; the columns are the normal and the two turned directions in the plane.

    The rows of a collapsed triangle are the identity turned, whatever the corners, with zero gradient to them.
    """
    columns, _ = _axes(*_components(bound, _corners(bound))[:2])
    full = [jnp.broadcast_to(part, columns[1][0].shape) for column in columns for part in column]
    return jnp.stack(full, axis=-1).reshape(-1, 3, 3).swapaxes(1, 2)


def opacities(bound: BoundGaussians) -> Array:
    """`[G]` opacities in (0, 1); 0 on a collapsed triangle, which has no side to show."""
    return _opacities_with_area(bound, _frames(*matrix_rows(_corners(bound)))[3])


@drawable.register
def _(bound: BoundGaussians) -> Drawable:
    corners = _corners(bound)
    covars, has_area = _covariances(bound, corners)
    return Drawable(
        means=_means(bound, corners),
        opacities=_opacities_with_area(bound, has_area),
        sh_dc=bound.sh_dc,
        sh_rest=bound.sh_rest,
        covars=covars,
        pixel_filter=bound.pixel_filter,
    )


def to_gaussians(bound: BoundGaussians) -> Gaussians:
    """The same Gaussians without their mesh, numpy: for files in the 3DGS layout. Rows keep their places.

    The first axis is the triangle's normal. Gaussians of collapsed triangles get an opacity too faint to be drawn.
    """
    scalars = np.asarray(bound.log_scales)
    thickness = np.full_like(scalars[:, :1], np.log(bound.thickness))
    visible = np.asarray(opacities(bound)) > 0
    turns = Rotation.from_matrix(np.asarray(axes(bound), np.float64))
    return Gaussians(
        means=np.asarray(means(bound)),
        quats=turns.as_quat()[:, [3, 0, 1, 2]].astype(np.float32),
        log_scales=np.concatenate([thickness, scalars], axis=1),
        logit_opacities=np.where(visible, bound.logit_opacities, np.float32(DEAD_LOGIT)),
        sh_dc=np.asarray(bound.sh_dc),
        sh_rest=np.asarray(bound.sh_rest),
        pixel_filter=bound.pixel_filter,
    )


def to_mesh(bound: BoundGaussians) -> Mesh:
    """The mesh, its vertices coloured by the constant colours of the Gaussians around, weighted by nearness."""
    faces, barycentric = np.asarray(_faces(bound)), LAYOUTS[bound.per_triangle][0]
    shade = np.asarray(bound.sh_dc, np.float64)[:, 0].reshape(len(faces), -1, 3) * SH_C0 + 0.5
    weights = barycentric[None] * np.asarray(opacities(bound), np.float64).reshape(len(faces), -1, 1)
    colors, total = np.full((len(bound.vertices), 3), 0.5e-9), np.full((len(bound.vertices), 1), 1e-9)
    for corner in range(3):
        np.add.at(colors, faces[:, corner], np.sum(weights[..., corner, None] * np.clip(shade, 0, 1), axis=1))
        np.add.at(total, faces[:, corner], np.sum(weights[..., corner], axis=1, keepdims=True))
    return Mesh(np.asarray(bound.vertices, np.float32), faces, np.rint(255 * colors / total).astype(np.uint8))


def _faces(bound: BoundGaussians) -> Array:
    assert bound.faces is not None, "these are free parameters without faces"
    return bound.faces


def _corners(bound: BoundGaussians) -> Array:
    """`[F, 3, 3]` places of the corners: the one gathering that all that is drawn shares."""
    return bound.vertices[_faces(bound)]


def _means(bound: BoundGaussians, corners: Array) -> Array:
    barycentric = jnp.asarray(LAYOUTS[bound.per_triangle][0], corners.dtype)
    return jnp.sum(barycentric[None, :, :, None] * corners[:, None], axis=2).reshape(-1, 3)


def _opacities_with_area(bound: BoundGaussians, has_area: Array) -> Array:
    return jnp.where(jnp.repeat(has_area, bound.per_triangle), jax.nn.sigmoid(bound.logit_opacities), 0)


def _covariances(bound: BoundGaussians, corners: Array) -> tuple[Array, Array]:
    """`[G, 3, 3]` covariances, and `[F]` whether a triangle has an area."""

    def shapes(corners: Matrix, turns: Vector, log_scales: Vector) -> tuple[Vector, Array]:
        columns, has_area = _axes(corners, turns)
        factors = [bound.thickness, *map(jnp.exp, log_scales)]
        scaled = [[factor * part for part in column] for factor, column in zip(factors, columns, strict=True)]
        rows = [list(row) for row in zip(*scaled, strict=True)]
        return [dot(rows[i], rows[j]) for i in range(3) for j in range(i, 3)], has_area

    is_there = jnp.any(jnp.isfinite(bound.vertices))
    (xx, xy, xz, yy, yz, zz), has_area = walled(jax.checkpoint(shapes), is_there, *_components(bound, corners))
    entries = jnp.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1)
    return entries.reshape(-1, 3, 3), has_area[:, 0]


def _components(bound: BoundGaussians, corners: Array) -> tuple[Matrix, Vector, Vector]:
    """Corners in arrays `[F, 1]`, and turns and log scales in arrays of `[F, n]`.

    XLA's CPU loops over rows of structs are several times slower.
    """
    of_triangles = (len(corners), bound.per_triangle)
    turns, log_scales = (
        [part.reshape(of_triangles) for part in components(field)] for field in (bound.rotations, bound.log_scales)
    )
    return matrix_rows(corners[:, None]), turns, log_scales


def _axes(corners: Matrix, turns: Vector) -> tuple[Matrix, Array]:
    """The normal `[F, 1]` and two turned directions in the plane `[F, n]`, and `[F, 1]` whether there is an area."""
    normal, first, second, has_area = _frames(*corners)
    re, im = unit_turns(turns)
    turned = [re * u + im * v for u, v in zip(first, second, strict=True)]
    across = [re * v - im * u for u, v in zip(first, second, strict=True)]
    return [normal, turned, across], has_area


def unit_turns(turns: Vector) -> Vector:
    """Complex numbers of length 1, as two parts; 0 is read as 1, with zero gradient."""
    re, im = turns
    squared = re * re + im * im
    is_zero = squared < 1e-24
    inverse = jax.lax.rsqrt(jnp.where(is_zero, 1, squared))
    return [jnp.where(is_zero, 1, re * inverse), jnp.where(is_zero, 0, im * inverse)]


def _frames(a: Vector, b: Vector, c: Vector) -> tuple[Vector, Vector, Vector, Array]:
    """Unit normal, unit first edge, their cross product, and whether there is an area."""
    sides = [[q - p for p, q in zip(start, end, strict=True)] for start, end in ((b, a), (b, c), (c, a))]
    longest = jax.lax.stop_gradient(reduce(jnp.maximum, [jnp.abs(part) for side in sides for part in side]))
    size = jnp.where(longest > 0, longest, 1)
    along, other = ([part / size for part in side] for side in sides[:2])
    across = cross(other, along)
    has_area = dot(across, across) > COLLAPSED**2
    along = [jnp.where(has_area, part, harmless) for part, harmless in zip(along, (0, 1, 0), strict=True)]
    across = [jnp.where(has_area, part, harmless) for part, harmless in zip(across, (1, 0, 0), strict=True)]
    normal, first = ([part * jax.lax.rsqrt(dot(v, v)) for part in v] for v in (across, along))
    return normal, first, cross(normal, first), has_area
