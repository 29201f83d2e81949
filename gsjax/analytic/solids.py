"""A small world of our own, known exactly: textured solids on a round table, sphere-traced from distance functions.

Everything here is a function of one world point (or one ray) and mapped over many by `jax.vmap`. The world is z up, of
unit scale (the solids fit in a cylinder of radius 0.75 and height 0.85), lit by one sun and a white sky; nothing in it
depends on the viewing direction. The background is white.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.scene.cameras import Camera, center, look_at, pixel_rays, project, rotation, world_to_camera
from gsjax.scene.colors import linear_to_srgb, srgb_to_linear

GROUND_LABEL = 255
TABLE_RADIUS = 1.6
BOUNDS = ((-1.65, -1.65, -0.12), (1.65, 1.65, 0.95))  # of everything solid, world units

BLOCK = 192 * 192  # points at once: the pixels of the demo's photos, whose programs then serve the surface as well

_EXACT = jax.lax.Precision.HIGHEST  # of products: a GPU's matrix units would round their factors to ten bits
_TABLE_THICKNESS = 0.08
_SHADOW_STEPS = 22
_FAR = 8.0  # where a ray has left the world
_HIT = 1e-5  # residual distance at which a ray is on the surface
BEFORE = 5e-5  # by so much normals are read ahead of the surface, world units
_SUN = np.array([0.45, -0.35, 0.82]) / np.linalg.norm([0.45, -0.35, 0.82])
_SUN_SHARPNESS = 14.0  # penumbra: 1 / the sun's apparent radius
_SUN_LIGHT, _SKY_LIGHT = 0.85, 0.42  # linear irradiance of a surface that faces them

_PALETTES = np.array(  # sRGB, the two colours of: carved box, ring, pear, drum, soft cube, table
    [
        [[0.14, 0.25, 0.46], [0.95, 0.85, 0.66]],
        [[0.78, 0.30, 0.18], [0.97, 0.90, 0.76]],
        [[0.07, 0.45, 0.42], [0.90, 0.88, 0.48]],
        [[0.43, 0.18, 0.42], [0.97, 0.70, 0.56]],
        [[0.92, 0.66, 0.14], [0.24, 0.30, 0.38]],
        [[0.87, 0.84, 0.78], [0.47, 0.53, 0.52]],
    ]
)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Trace:
    """What a camera sees of the world; geometry at pixel centres, colour averaged over the pixel's area."""

    depth: Array  # [H, W] float32 camera z, 0 where the ray meets nothing
    normals: Array  # [H, W, 3] float32 unit, camera frame, towards the camera; 0 where the ray meets nothing
    colors: Array  # [H, W, 3] float32 sRGB, 0..1
    labels: Array  # [H, W] uint8: 0 sky, 1..5 the solids, 255 the table


def trace(camera: Camera, *, samples: int = 3) -> Trace:
    """Renders the world by sphere tracing, with `samples` of colour along each side of a pixel.

    Compiles once per image size, whatever the pose and focal length.
    """
    offsets = (np.arange(samples, dtype=np.float32) + 0.5) / samples - 0.5
    light = sum(_light_of_rays(camera, x, y) for y in offsets for x in offsets) / samples**2
    origins, directions = _world_rays(camera, 0.0, 0.0)
    distances = _cast_all(origins, directions)
    points = _just_before(origins, directions, distances)
    return _traced(camera, distances, normal_all(points), label_all(points), light)


@jax.jit
def _traced(camera: Camera, distances: Array, normals: Array, labels: Array, light: Array) -> Trace:
    """What `[H W]` rays have met, as images."""
    hit = (distances > 0).reshape(camera.height, camera.width)
    depth = distances.reshape(hit.shape) / jnp.linalg.norm(pixel_rays(camera), axis=-1)
    return Trace(
        depth=jnp.where(hit, depth, 0.0),
        normals=jnp.where(hit[..., None], _turned(normals, rotation(camera)).reshape(*hit.shape, 3), 0.0),
        colors=linear_to_srgb(light).reshape(*hit.shape, 3),
        labels=jnp.where(hit, labels.reshape(hit.shape), 0).astype(jnp.uint8),
    )


def _light_of_rays(camera: Camera, offset_x: float, offset_y: float) -> Array:
    origins, directions = _world_rays(camera, offset_x, offset_y)
    distances = _march_all(origins, directions)
    light = shade_all(_just_before(origins, directions, distances))
    return jnp.where(distances[:, None] > 0, light, 1.0)


@jax.jit
def _just_before(origins: Array, directions: Array, distances: Array) -> Array:
    """`[R, 3]` points where the distance has a slope: on a face it is a maximum of two that are equal but for rounding.

    The gradient of a maximum goes to whom it equals, and a compiler that computes them twice may find none.
    """
    return origins + (distances - BEFORE)[:, None] * directions


@jax.jit
def _world_rays(camera: Camera, offset_x: float, offset_y: float) -> tuple[Array, Array]:
    """`[H W, 3]` origins and unit directions of the rays through all pixels, off their centres by so many pixels."""
    offset = jnp.stack([offset_x / camera.K[0, 0], offset_y / camera.K[1, 1], jnp.zeros_like(camera.K[0, 0])])
    rays = (pixel_rays(camera) + offset[None, None]).reshape(-1, 3)
    directions = _turned(rays / jnp.linalg.norm(rays, axis=-1, keepdims=True), rotation(camera).T)
    return jnp.broadcast_to(center(camera), directions.shape), directions


def _turned(vectors: Array, rotation: Array) -> Array:
    """`[R, 3]` vectors by a `[3, 3]` rotation."""
    return jnp.matmul(vectors, rotation.T, precision=_EXACT)


def cast(origin: Array, direction: Array) -> Array:
    """`[]` distance along a ray (`[3]` origin, `[3]` unit direction) to the first surface, 0 where it meets none.

    Exact to 1e-5 units. A ray that grazes a surface for so long that it stays undecided (one in some thousands, along
    silhouettes) counts as meeting none.
    """
    distance = march(origin, direction, steps=300)
    return jnp.where(scene_sdf(origin + distance * direction) < _HIT, distance, 0.0)


def march(origin: Array, direction: Array, *, steps: int = 72) -> Array:
    """`[]` distance as `cast` gives it, but only as near to the surface as `steps` lead.

    A ray that is still on its way (it grazes a surface) counts as having met it: right for colour, not for geometry.
    """

    def step(_: int, distance: Array) -> Array:
        return jnp.minimum(distance + scene_sdf(origin + distance * direction), _FAR)

    distance = jax.lax.fori_loop(0, steps, step, jnp.float32(0.0))
    return jnp.where(distance < _FAR, distance, 0.0)


def shade(point: Array) -> Array:
    """`[3]` linear rgb of a `[3]` surface point: albedo under the sun with soft shadow and the sky with occlusion."""
    up = normal(point)
    sun = jnp.asarray(_SUN, jnp.float32)
    lambert = jnp.maximum(jnp.sum(up * sun), 0.0) * sun_visibility(point + 2e-3 * up)
    open_sky = jnp.clip(scene_sdf(point + 0.12 * up) / 0.12, 0.2, 1.0) * (0.65 + 0.35 * up[2])
    return jnp.clip(srgb_to_linear(albedo(point)) * (_SUN_LIGHT * lambert + _SKY_LIGHT * open_sky), 0.0, 1.0)


def sun_visibility(point: Array) -> Array:
    """`[]` share of the sun (0..1) seen from a `[3]` point: the narrowest relative gap on the way to it."""
    sun = jnp.asarray(_SUN, jnp.float32)

    def step(_: int, state: tuple[Array, Array]) -> tuple[Array, Array]:
        distance, visibility = state
        gap = scene_sdf(point + distance * sun)
        visibility = jnp.minimum(visibility, _SUN_SHARPNESS * gap / distance)
        return distance + jnp.clip(gap, 0.01, 0.2), visibility

    _, visibility = jax.lax.fori_loop(0, _SHADOW_STEPS, step, (jnp.float32(0.01), jnp.float32(1.0)))
    visibility = jnp.clip(visibility, 0.0, 1.0)
    return visibility * visibility * (3.0 - 2.0 * visibility)


def normal(point: Array) -> Array:
    """`[3]` unit normal, outwards: the gradient of the distance at a `[3]` point."""
    gradient = jax.grad(scene_sdf)(point)
    return gradient / jnp.maximum(_length(*gradient), 1e-6)


def scene_sdf(point: Array) -> Array:
    """`[]` signed distance of a `[3]` point to the nearest surface, negative inside; never more than the true one."""
    nearest, *others = part_sdfs(point)
    for other in others:
        nearest = jnp.minimum(nearest, other)
    return nearest


def label(point: Array) -> Array:
    """`[]` uint8 of the part nearest to a `[3]` point: 1..5 the solids, 255 the table."""
    part = jnp.argmin(jnp.stack(part_sdfs(point)))
    return jnp.where(part == len(_PALETTES) - 1, GROUND_LABEL, part + 1).astype(jnp.uint8)


def part_sdfs(point: Array) -> tuple[Array, ...]:
    """Signed distances of a `[3]` point to the five solids and, last, the table."""
    x, y, z = point
    return (
        _carved_box(x + 0.36, y - 0.30, z),
        _ring(x - 0.34, y - 0.36, z),
        _pear(x - 0.36, y + 0.32, z),
        _drum(x + 0.30, y + 0.38, z),
        _soft_cube(x + 0.02, y + 0.02, z),
        _cylinder(x, y, z + 0.5 * _TABLE_THICKNESS, TABLE_RADIUS, 0.5 * _TABLE_THICKNESS),
    )


def albedo(point: Array) -> Array:
    """`[3]` sRGB colour of the material at a `[3]` point, 0..1.

    Two colours a part, mixed by a soft-edged pattern of its own, under grain that leaves no patch flat. The finest
    detail is about 0.05 units wide: three pixels of a 160-pixel image.
    """
    x, y, z = point
    coarse, fine = _grain(point, _COARSE_WAVES), _grain(point, _FINE_WAVES)
    patterns = (
        _wave((x + y + 1.4 * z) / 0.17 + 0.6 * coarse),
        _wave(x / 0.19) * _wave(y / 0.19) * _wave(z / 0.19),
        _wave(z / 0.26 + 1.3 * coarse),
        _wave(1.5 * jnp.arctan2(y + 0.38, x + 0.30)) * _wave((z + 0.03) / 0.2),
        _wave(1.2 * coarse + 0.35 * fine),
        0.65 * _wave((x + y) / 0.5) * _wave((x - y) / 0.5) + 0.35 * jnp.tanh(fine),
    )
    part = jnp.argmin(jnp.stack(part_sdfs(point)))
    first, second = jnp.asarray(_PALETTES, jnp.float32)[part]
    mix = 0.5 + 0.5 * jnp.stack(patterns)[part]
    tint = jnp.array([0.015, 0.0, -0.02], jnp.float32) * coarse
    return jnp.clip((first + (second - first) * mix) * (1.0 + 0.07 * fine + 0.05 * coarse) + tint, 0.02, 0.98)


def visible(point: Array, camera: Camera) -> Array:
    """`[]` bool: a `[3]` surface point is in the image and nothing is before it (within 0.005 units)."""
    point_cam = world_to_camera(point, camera)
    pixel = project(point_cam, camera)
    inside = jnp.all((pixel >= 0) & (pixel < jnp.array([camera.width, camera.height], jnp.float32)))
    origin = center(camera)
    distance = _length(*(point - origin))
    return inside & (point_cam[2] > 0) & (march(origin, (point - origin) / distance) > distance - 5e-3)


def cameras(num_views: int, size: tuple[int, int], *, seed: int = 0) -> list[Camera]:
    """Cameras on three rings around the solids, about 3 units away, spread evenly and jittered.

    They share one K with fx != fy and an off-centre principal point; `size` is (width, height). Any stretch of
    consecutive views covers all rings and directions.
    """
    rng = np.random.default_rng(seed)
    width, height = size
    focal = 1.4 * max(size)
    K = np.array([[focal, 0, 0.506 * width], [0, 0.993 * focal, 0.493 * height], [0, 0, 1]], np.float32)
    golden_angle = np.pi * (3 - np.sqrt(5))
    views = []
    for i in range(num_views):
        azimuth = golden_angle * i + rng.normal(0, 0.08)
        elevation = np.deg2rad((20.0, 38.0, 58.0)[i % 3] + rng.uniform(-4, 4))
        horizontal = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth), 0])
        eye = rng.uniform(2.75, 3.15) * (horizontal + np.array([0, 0, np.sin(elevation)]))
        target = np.array([0, 0, 0.22]) + rng.uniform(-0.06, 0.06, 3)
        views.append(
            Camera(jnp.asarray(look_at(eye, target, np.array([0.0, 0.0, 1.0]))), jnp.asarray(K), width, height)
        )
    return views


# The shapes, each around its own foot at the origin. Coordinates are scalars, which keeps the mapped code vectorised.
# All reach a little into the table: a sole level with its top would leave a sheet of distance zero inside the union.


def _carved_box(x: Array, y: Array, z: Array) -> Array:
    """Sharp box with a bowl cut into its upper corner."""
    x, y = _turn(x, y, 0.45)
    return jnp.maximum(_box(x, y, z - 0.26, 0.21, 0.17, 0.28), 0.19 - _length(x + 0.12, y + 0.16, z - 0.52))


def _ring(x: Array, y: Array, z: Array) -> Array:
    """Upright torus."""
    x, y = _turn(x, y, -0.8)
    return _length(_length(x, z - 0.30) - 0.22, y) - 0.085


def _pear(x: Array, y: Array, z: Array) -> Array:
    """Two balls grown together."""
    return _smooth_union(_length(x, y, z - 0.20) - 0.21, _length(x + 0.03, y - 0.02, z - 0.50) - 0.12, 0.16)


def _drum(x: Array, y: Array, z: Array) -> Array:
    """Sharp cylinder with a hollow top."""
    return jnp.maximum(_cylinder(x, y, z - 0.16, 0.20, 0.18), 0.17 - _length(x, y, z - 0.40))


def _soft_cube(x: Array, y: Array, z: Array) -> Array:
    """Tilted cube with round edges."""
    x, z = _turn(x, z - 0.16, 0.3)
    y, z = _turn(y, z, 0.25)
    return _box(x, y, z, 0.09, 0.09, 0.09) - 0.035


def _box(x: Array, y: Array, z: Array, half_x: float, half_y: float, half_z: float) -> Array:
    x, y, z = jnp.abs(x) - half_x, jnp.abs(y) - half_y, jnp.abs(z) - half_z
    inside = jnp.minimum(jnp.maximum(x, jnp.maximum(y, z)), 0.0)
    return _length(jnp.maximum(x, 0.0), jnp.maximum(y, 0.0), jnp.maximum(z, 0.0)) + inside


def _cylinder(x: Array, y: Array, z: Array, radius: float, half_height: float) -> Array:
    radial, axial = _length(x, y) - radius, jnp.abs(z) - half_height
    return _length(jnp.maximum(radial, 0.0), jnp.maximum(axial, 0.0)) + jnp.minimum(jnp.maximum(radial, axial), 0.0)


def _smooth_union(a: Array, b: Array, width: float) -> Array:
    overlap = jnp.maximum(width - jnp.abs(a - b), 0.0) / width
    return jnp.minimum(a, b) - 0.25 * width * overlap * overlap


def _turn(a: Array, b: Array, angle: float) -> tuple[Array, Array]:
    cos, sin = float(np.cos(angle)), float(np.sin(angle))
    return cos * a + sin * b, cos * b - sin * a


def _length(*components: Array) -> Array:
    """Euclidean length, never less than 1e-15; there its gradient is zero.

    A lower bound, not a mask: a compiled program may round a mask and the masked value differently.
    """
    return jnp.sqrt(jnp.maximum(sum(c * c for c in components), 1e-30))


# Textures and colour.


def _waves(shortest: float, longest: float, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Wave vectors `[count, 3]` (radians per unit) of wavelengths in a range, all directions, and their phases."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    wavelengths = np.geomspace(shortest, longest, count)
    return 2 * np.pi * directions / wavelengths[:, None], rng.uniform(0, 2 * np.pi, count)


_COARSE_WAVES = _waves(0.22, 0.6, 10, seed=1)
_FINE_WAVES = _waves(0.06, 0.14, 14, seed=2)


def _grain(point: Array, waves: tuple[np.ndarray, np.ndarray]) -> Array:
    """`[]` noise of unit variance at a point: plane waves, so its band is exactly theirs."""
    vectors, phases = (jnp.asarray(w, jnp.float32) for w in waves)
    return jnp.sqrt(2.0 / len(phases)) * jnp.sum(jnp.cos(jnp.matmul(vectors, point, precision=_EXACT) + phases))


def _wave(cycles: Array) -> Array:
    """Square wave in -1..1 with soft edges."""
    return jnp.tanh(2.5 * jnp.sin(2 * jnp.pi * cycles))


# Each stage is compiled by itself: in one program XLA would fuse a stage into every use of its result and compute it
# again there, a hundred times slower.
_cast_all = jax.jit(jax.vmap(cast))
_march_all = jax.jit(jax.vmap(march))
normal_all = jax.jit(jax.vmap(normal))
label_all = jax.jit(jax.vmap(label))
shade_all = jax.jit(jax.vmap(shade))


def in_blocks(compiled: Callable[[np.ndarray], Array], points: np.ndarray) -> np.ndarray:
    """A compiled function of `[BLOCK, ...]` points at `[P, ...]` of them: one program serves, however many."""
    blocks = -(-len(points) // BLOCK)
    padded = np.pad(points, ((0, blocks * BLOCK - len(points)), (0, 0)), mode="edge")
    return np.concatenate([np.asarray(compiled(block)) for block in np.split(padded, blocks)])[: len(points)]
