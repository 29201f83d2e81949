"""Real spherical harmonics of degree 0 to 4 in the sign convention of 3DGS and gsplat.

`upper_bands`, which training evaluates in every step, has native loops on a CPU; all else is jnp.
"""

import math

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from rasterizer.arrays import takes_arrays, whole_number
from rasterizer.devices import default_device
from rasterizer.engines import Backend, load_loops, native_loops
from rasterizer.tracing import reverse_only, vary_alike

DC = 0.28209479177387814  # The basis function of degree 0, 1 / sqrt(4 pi).


def _basis(degree: int, x: Array, y: Array, z: Array) -> list[Array]:
    """Basis functions at a unit direction, ordered by degree and then by order -l..l."""
    values = [jnp.full_like(x, DC)]
    if degree == 0:
        return values
    values += [-0.48860251190291992 * y, 0.48860251190291992 * z, -0.48860251190291992 * x]
    if degree == 1:
        return values
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    values += [
        1.0925484305920790 * xy,
        -1.0925484305920790 * yz,
        0.31539156525252000 * (2 * zz - xx - yy),
        -1.0925484305920790 * xz,
        0.54627421529603950 * (xx - yy),
    ]
    if degree > 2:
        values += [
            -0.59004358992664350 * y * (3 * xx - yy),
            2.8906114426405540 * xy * z,
            -0.45704579946446570 * y * (4 * zz - xx - yy),
            0.37317633259011540 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.45704579946446570 * x * (4 * zz - xx - yy),
            1.4453057213202770 * z * (xx - yy),
            -0.59004358992664350 * x * (xx - 3 * yy),
        ]
    if degree > 3:
        values += [
            2.5033429417967046 * xy * (xx - yy),
            -1.7701307697799304 * yz * (3 * xx - yy),
            0.94617469575756000 * xy * (7 * zz - 1),
            -0.66904654355728920 * yz * (7 * zz - 3),
            0.10578554691520430 * (zz * (35 * zz - 30) + 3),
            -0.66904654355728920 * xz * (7 * zz - 3),
            0.47308734787878000 * (xx - yy) * (7 * zz - 1),
            -1.7701307697799304 * xz * (xx - 3 * yy),
            0.62583573544917610 * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
        ]
    return values


@takes_arrays
def spherical_harmonics(
    degrees_to_use: int,
    dirs: Float[Array, "... 3"],
    coeffs: Float[Array, "... K D"],
    masks: Bool[Array, "..."] | None = None,
) -> Float[Array, "... D"]:
    """Evaluate real spherical harmonics.

    Args:
        degrees_to_use: Highest degree used, 0 to 4. Static.
        dirs: Directions from the camera to the point, any length; a zero direction is read as +z with
            zero gradient.
        coeffs: Coefficients, K >= (degree + 1)^2; more are ignored.
        masks: Where it is False the value is 0 and nothing is read, so that it may be anything.

    Returns:
        Values, differentiable to `dirs` and `coeffs`. 3DGS colours are `max(value + 0.5, 0)`.

    Raises:
        ValueError: If the degree is not 0 to 4 or `coeffs` holds too few coefficients or no channel.
    """
    degree = whole_number("degrees_to_use", degrees_to_use, 0)
    if degree > 4:
        raise ValueError(f"spherical harmonics of degree {degree} are not supported, only 0 to 4")
    num_bases = (degree + 1) ** 2
    if coeffs.shape[-2] < num_bases:
        raise ValueError(f"degree {degree} needs {num_bases} coefficients, {coeffs.shape=} holds {coeffs.shape[-2]}")
    if coeffs.shape[-1] == 0:
        raise ValueError(f"{coeffs.shape=} holds no channel")
    if masks is not None:
        dirs = jnp.where(masks[..., None], dirs, jnp.array([0, 0, 1], dirs.dtype))
        coeffs = jnp.where(masks[..., None, None], coeffs, 0)
    return _sum_of_bands(_basis_at(degree, dirs), coeffs[..., :num_bases, :])


@takes_arrays
def upper_bands(
    dirs: Float[Array, "... 3"],
    coeffs: Float[Array, "... M D"],
    weights: Float[Array, "... M"] | None = None,
    *,
    backend: Backend = "auto",
) -> Float[Array, "... D"]:
    """The part of degree 1 and up of all coefficients that there are.

    Args:
        dirs: As in `spherical_harmonics`.
        coeffs: Coefficients without the first, M + 1 a square up to 25.
        weights: Factors of the basis functions, for a ramp of degrees; None for ones.
        backend: "native" is the loops of a CPU, for `[N, 3]` directions, float32 and degrees 1 to 3. Static.

    Returns:
        Values, differentiable to all three; with the loops by `jax.grad` and `jax.vjp` alone, once. With those of
        `spherical_harmonics_l0` they sum to all bands.
    """
    loops, bands = native_loops(backend), coeffs.shape[-2]
    are_rows = dirs.shape == (coeffs.shape[0], 3) and dirs.dtype == coeffs.dtype == jnp.float32
    if loops and are_rows and bands in loops.BANDS and coeffs.shape[1:] == (bands, loops.CHANNELS):
        rows = jnp.ones((1, bands)) if weights is None else jnp.asarray(weights, jnp.float32).reshape(-1, bands)
        if len(rows) in (1, len(dirs)):
            return _in_loops(*map(reverse_only, vary_alike((dirs, coeffs, rows))))
    return _in_jnp(dirs, coeffs, weights)


def _in_jnp(dirs: Array, coeffs: Array, weights: Array | None) -> Array:
    degree = math.isqrt(coeffs.shape[-2])
    basis = _basis_at(degree, dirs)[..., 1:]
    return _sum_of_bands(basis if weights is None else basis * jnp.broadcast_to(weights, basis.shape), coeffs)


def _basis_at(degree: int, dirs: Array) -> Array:
    """`[..., (degree + 1)^2]` basis functions at directions of any length."""
    # By coordinate: on a CPU sums and stacks along a short last axis are slow, and their transposes slower.
    x, y, z = jnp.moveaxis(dirs, -1, 0)
    # Divided by the largest entry first: the squares of a very long or short direction would overflow or vanish.
    largest = jax.lax.stop_gradient(jnp.maximum(jnp.maximum(jnp.abs(x), jnp.abs(y)), jnp.abs(z)))
    is_zero = largest < jnp.finfo(dirs.dtype).tiny
    safe = jnp.where(is_zero, 1, largest)
    x, y, z = (jnp.where(is_zero, default, each / safe) for each, default in ((x, 0), (y, 0), (z, 1)))
    inverse = jax.lax.rsqrt(x * x + y * y + z * z)
    return jnp.moveaxis(jnp.stack(_basis(degree, x * inverse, y * inverse, z * inverse)), 0, -1)


def _sum_of_bands(basis: Array, coeffs: Array) -> Array:
    """`[..., K]` times `[..., K, D]`: one product and one sum, not a term per band. Its transpose is an outer product.

    A CPU takes half as long for the product of matrices; those of a GPU round.
    """
    if default_device().platform == "cpu":
        return jnp.einsum("...k,...kd->...d", basis, coeffs, precision="highest")
    return jnp.sum(jnp.multiply(*jnp.broadcast_arrays(basis[..., None], coeffs)), axis=-2)


@takes_arrays
def spherical_harmonics_l0(sh0: Float[Array, "... 1 D"]) -> Float[Array, "... D"]:
    """The part of degree 0 of coefficients, gsplat's name."""
    return DC * sh0[..., 0, :]


def camera_directions(means: Array, viewmats: Array) -> Array:
    """`[..., C, N, 3]` from the centres of C cameras to N points."""
    centers = -jnp.sum(viewmats[..., :3, :3] * viewmats[..., :3, 3, None], axis=-2)
    return means[..., None, :, :] - centers[..., :, None, :]


@takes_arrays
def spherical_harmonics_l1_plus(
    degrees_to_use: int,
    means: Float[Array, "... N 3"],
    viewmats: Float[Array, "... C 4 4"],
    shN: Float[Array, "N M D"],
    masks: Bool[Array, "... C N"] | None = None,
) -> Float[Array, "... C N D"]:
    """The part of degree 1 and up, gsplat's name.

    Args:
        degrees_to_use: Highest degree used, 0 to 4. Static.
        means: World positions.
        viewmats: World to camera.
        shN: Coefficients without the first.
        masks: Where it is False the value is 0.

    Returns:
        Values, differentiable to means, viewmats and coefficients. With those of `spherical_harmonics_l0` they sum to
        all bands; 3DGS colours are `max(sum + 0.5, 0)`.

    Raises:
        ValueError: As `spherical_harmonics`.
    """
    dirs = camera_directions(means, viewmats)
    shN = jnp.broadcast_to(shN, (*dirs.shape[:-1], *shN.shape[-2:]))
    no_dc = jnp.zeros((*shN.shape[:-2], 1, shN.shape[-1]), shN.dtype)
    return spherical_harmonics(degrees_to_use, dirs, jnp.concatenate([no_dc, shN], -2), masks)


@jax.custom_vjp
def _in_loops(dirs: Array, coeffs: Array, weights: Array) -> Array:
    return load_loops().call("upper_bands", dirs, dirs, coeffs, weights)


def _in_loops_bwd(residuals, cotangents: Array):
    dirs, coeffs, weights = residuals
    gradients = load_loops().call("upper_bands_gradient", (dirs, coeffs), dirs, coeffs, weights, cotangents)
    # XLA leaves this out where no gradient to the weights is used.
    of_weights = jax.vjp(lambda weights: _in_jnp(dirs, coeffs, weights), weights)[1]
    return *gradients, *of_weights(cotangents)


_in_loops.defvjp(lambda *arguments: (_in_loops(*arguments), arguments), _in_loops_bwd)
