"""Covariances of Gaussians, in space and in the image: 3x3 algebra written out in components.

Written out, no matrix unit ever rounds a pose or a covariance, and every line is one wide operation over all Gaussians.
A component is an array of any shape; shapes broadcast.
"""

from functools import reduce

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from rasterizer.arrays import takes_arrays

Vector = list[Array]
Matrix = list[Vector]  # rows
SymmetricMatrices = Float[Array, "*batch 3 3"] | Float[Array, "*batch 6"]  # as a whole, or its upper triangle


def components(vectors: Array) -> Vector:
    """`[..., n]` -> n arrays `[...]`."""
    return [vectors[..., i] for i in range(vectors.shape[-1])]


def matrix_rows(matrices: Array) -> Matrix:
    """`[..., n, m]` -> n rows of m arrays `[...]`."""
    return [components(matrices[..., i, :]) for i in range(matrices.shape[-2])]


def camera_rows(matrices: Array) -> Matrix:
    """`[..., C, n, m]` of C cameras -> n rows of m arrays `[..., C, 1]`, which broadcast against Gaussians."""
    return [[entry[..., None] for entry in row] for row in matrix_rows(matrices)]


def dot(a: Vector, b: Vector) -> Array:
    """Scalar product in three dimensions."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return [a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3] for i in range(3)]


def rotation(quat: Vector) -> Matrix:
    """The rotation of a quaternion (w, x, y, z) of any length; zero gives the identity, with zero gradient."""
    # Divided by its largest entry first: the square of a long one would overflow.
    largest = jax.lax.stop_gradient(reduce(jnp.maximum, [jnp.abs(part) for part in quat]))
    is_zero = largest < 1e-12
    quat = [part / jnp.where(is_zero, 1, largest) for part in quat]
    inverse = jax.lax.rsqrt(jnp.where(is_zero, 1, sum(part * part for part in quat)))
    w, x, y, z = (jnp.where(is_zero, one, part * inverse) for part, one in zip(quat, (1, 0, 0, 0), strict=True))
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def seen_from_axes(row_x: Vector, row_y: Vector, quat: Vector, scales: Vector) -> tuple[Array, Array, Array, Array]:
    """(xx, xy, yy, determinant) of A R S S R^T A^T for the 2x3 map A with the given rows.

    The determinant is the squared cross product of the rows of A R S (Lagrange's identity): a needle of any aspect
    keeps a positive one, where xx yy - xy^2 cancels to noise in float32.
    """
    axes = rotation(quat)
    columns = [[axes[i][j] for i in range(3)] for j in range(3)]
    x = [dot(row_x, columns[j]) * scales[j] for j in range(3)]
    y = [dot(row_y, columns[j]) * scales[j] for j in range(3)]
    normal = cross(x, y)
    return dot(x, x), dot(x, y), dot(y, y), dot(normal, normal)


def seen_from_triangle(row_x: Vector, row_y: Vector, triangle: Vector) -> tuple[Array, Array, Array, Array]:
    """(xx, xy, yy, determinant) of A Sigma A^T for a Sigma given by its upper triangle (xx, xy, xz, yy, yz, zz).

    The determinant is n^T adj(Sigma) n with n the cross product of the rows of A (Cauchy-Binet).
    """
    rows, adjugate = symmetric(triangle)
    x, y, normal = [dot(row, row_x) for row in rows], [dot(row, row_y) for row in rows], cross(row_x, row_y)
    det = dot(normal, [dot(row, normal) for row in adjugate])
    return dot(row_x, x), dot(row_x, y), dot(row_y, y), det


def tilt_from_axes(
    row_x: Vector, row_y: Vector, row_z: Vector, quat: Vector, scales: Vector
) -> tuple[Array, Array, Array, Array]:
    """(xz, yz, slope_x, slope_y): what a Gaussian's depth has to do with its image, for the 3x3 map of the given rows.

    `xz`, `yz` are covariances of image and depth; `slope_x`, `slope_y` are the adjugate of the sharp 2x2 covariance
    times them. Written out these are differences such as yy xz - xy yz, which for a needle cancel to noise; as
    products of crosses (Binet-Cauchy) they keep their digits, as the determinant does.
    """
    axes = rotation(quat)
    columns = [[axes[i][j] for i in range(3)] for j in range(3)]
    x, y, z = ([dot(row, columns[j]) * scales[j] for j in range(3)] for row in (row_x, row_y, row_z))
    normal = cross(x, y)
    return dot(x, z), dot(y, z), dot(normal, cross(z, y)), dot(normal, cross(x, z))


def tilt_from_triangle(
    row_x: Vector, row_y: Vector, row_z: Vector, triangle: Vector
) -> tuple[Array, Array, Array, Array]:
    """`tilt_from_axes` of a covariance given by its upper triangle."""
    rows, adjugate = symmetric(triangle)
    z = [dot(row, row_z) for row in rows]
    normal = cross(row_x, row_y)
    adjugate_normal = [dot(row, normal) for row in adjugate]
    return (
        dot(row_x, z),
        dot(row_y, z),
        dot(adjugate_normal, cross(row_z, row_y)),
        dot(adjugate_normal, cross(row_x, row_z)),
    )


def symmetric(triangle: Vector) -> tuple[Matrix, Matrix]:
    """A symmetric matrix and its adjugate, of the upper triangle."""
    xx, xy, xz, yy, yz, zz = triangle
    rows = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    return rows, [cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])]


def upper_triangle(matrices: Array) -> Array:
    """`[..., 3, 3]` -> `[..., 6]` (xx, xy, xz, yy, yz, zz)."""
    return jnp.stack([matrices[..., i, j] for i in range(3) for j in range(i, 3)], -1)


@takes_arrays
def quat_scale_to_covar_preci(
    quats: Float[Array, "*batch 4"],
    scales: Float[Array, "*batch 3"],
    compute_covar: bool = True,
    compute_preci: bool = True,
    triu: bool = False,
) -> tuple[SymmetricMatrices | None, SymmetricMatrices | None]:
    """Covariances R S S R^T and precisions of Gaussians. Name and arguments of gsplat.

    Args:
        quats: Rotations (w, x, y, z) of any length; a zero one is the identity.
        scales: Standard deviations.
        compute_covar: Whether covariances are returned. Static.
        compute_preci: Whether precisions are returned; infinite along a flat axis. Static.
        triu: Whether matrices are returned as upper triangles (xx, xy, xz, yy, yz, zz). Static.

    Returns:
        Covariances and precisions, None where not requested. Differentiable to both arguments.

    Raises:
        ValueError: If the shapes do not fit.
    """
    if quats.shape[-1:] != (4,) or scales.shape != (*quats.shape[:-1], 3):
        raise ValueError(f"{quats.shape=} and {scales.shape=}, expected [..., 4] and [..., 3]")
    axes, factors = rotation(components(quats)), components(scales)

    def matrices(factors: Vector) -> Array:
        scaled = [[axes[i][j] * factors[j] for j in range(3)] for i in range(3)]
        full = jnp.stack([jnp.stack([dot(a, b) for b in scaled], -1) for a in scaled], -2)
        return upper_triangle(full) if triu else full

    precisions = matrices([1 / factor for factor in factors]) if compute_preci else None
    return matrices(factors) if compute_covar else None, precisions
