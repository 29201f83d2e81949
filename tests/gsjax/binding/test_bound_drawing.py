"""What Gaussians on a surface look like, and how far the picture is from that of the surface."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import mesh_of, square
from small_scenes import camera_at

from gsjax import rendering
from gsjax.binding.bound import BoundGaussians, bind
from gsjax.rendering import gallery
from gsjax.scene import cameras
from gsjax.scene.cameras import Camera, look_at
from gsjax.scene.meshes import Mesh

WAVE, EDGE, VERTICES_A_SIDE = 0.3, 0.03, 50  # of the stripes, of a triangle
ELEVATION = np.radians(38)


def painted_plane(seed=0) -> Mesh:
    """A ground plane in stripes along x, its vertices a little out of their grid."""
    rng, n = np.random.default_rng(seed), VERTICES_A_SIDE
    x, y = (axis.ravel() for axis in np.meshgrid(*[(np.arange(n) - n / 2) * EDGE] * 2))
    shift = rng.uniform(-0.3, 0.3, (2, n * n)) * EDGE
    vertices = np.stack([x + shift[0], y + shift[1], 0 * x], axis=-1).astype(np.float32)
    shade = 127.5 + 100 * np.sin(2 * np.pi * vertices[:, 1:2] / WAVE)
    return mesh_of(vertices, square(n - 1).faces, np.rint(shade))


def camera_and_eye() -> tuple[Camera, np.ndarray]:
    """A camera over the plane, 3 units away; its pixels are 0.011 units. And where its centre is."""
    eye = 3 * np.array([0, np.cos(ELEVATION), np.sin(ELEVATION)])
    K = np.array([[270, 0, 48], [0, 270, 48], [0, 0, 1]], np.float32)
    return Camera(jnp.asarray(look_at(eye, np.zeros(3), np.array([0.0, 0, 1]))), jnp.asarray(K), 96, 96), eye


def seeming_height(bound: BoundGaussians) -> float:
    """How far over the plane the stripes seem to lie: their shift away from the camera, read as parallax."""
    camera, eye = camera_and_eye()
    rays = np.asarray(cameras.pixel_rays(camera)).reshape(-1, 3) @ np.asarray(camera.viewmat)[:3, :3]
    points = eye - rays * (eye[2] / rays[:, 2:])
    inner = np.all(np.abs(points[:, :2]) < 0.45, axis=1)
    picture = next(gallery.pictures(bound, [camera], np.zeros(3)))
    phase = 2 * np.pi * points[inner, 1] / WAVE
    waves = np.stack([np.sin(phase), np.cos(phase), np.ones_like(phase)], axis=-1)
    sine, cosine, _ = np.linalg.lstsq(waves, picture.colors[..., 0].ravel()[inner], rcond=None)[0]
    moved = -np.arctan2(cosine, sine) / (2 * np.pi) * WAVE
    return -moved * np.tan(ELEVATION)


@pytest.mark.long  # `tests/gsjax/rendering/test_render.py` has the filter itself.
def test_the_mip_filter_halves_the_false_height_of_a_painted_plane():
    # Discs are blended in the order of their centres, so each covers the near part of the one behind it; the wider
    # they are drawn, the more.
    start = bind(painted_plane(), per_triangle=1, thickness=3e-6, sh_degree=0, opacity=0.93)
    wider = replace(start, log_scales=start.log_scales + np.float32(np.log(1.3)))
    classic, mip = (seeming_height(replace(wider, pixel_filter=name)) for name in ("classic", "mip"))
    assert 0.6 * 0.011 < classic < 0.011  # most of a pixel
    assert 0 < mip < 0.6 * classic


def test_the_far_side_is_in_the_mean_depth_of_discs_and_not_in_that_of_those_in_front():
    """A ground over another one, discs narrower than their triangles and not opaque: a hollow thing's two sides."""
    near = painted_plane()
    far = Mesh(near.vertices - np.float32([0, 0, 0.5]), near.faces + len(near.vertices), near.colors)
    parts = ("vertices", "faces", "colors")
    both = Mesh(*(np.concatenate([getattr(near, part), getattr(far, part)]) for part in parts))
    start = bind(both, per_triangle=1, thickness=3e-6, sh_degree=0, opacity=0.85, pixel_filter="mip")
    camera, eye = camera_and_eye()
    rays = np.asarray(cameras.pixel_rays(camera)).reshape(-1, 3)
    world = rays @ np.asarray(camera.viewmat)[:3, :3]
    true = eye[2] / -world[:, 2]
    inner = np.all(np.abs(eye + true[:, None] * world)[:, :2] < 0.3, axis=1)
    mean, front = (next(gallery.pictures(start, [camera], np.zeros(3), m)).depth.ravel() for m in ("plane", "discs"))
    is_covered = inner & (mean > 0)
    np.testing.assert_array_equal(mean > 0, front > 0)
    assert is_covered.sum() > 0.9 * inner.sum()
    off, off_front = ((depth - true * rays[:, 2])[is_covered] for depth in (mean, front))
    right, right_front = (np.mean(np.abs(each) < 0.011) for each in (off, off_front))  # within a pixel
    assert right < 0.3 and np.mean(off) > 0.03
    assert right_front > 0.6, "where discs leave less than four tenths of the light to the far side"


def test_a_triangle_seen_edge_on_through_the_mip_filter_is_finite_in_value_and_gradient():
    corners = np.array([[0.0, -0.5, 3.5], [0, 0.5, 3.5], [0, 0, 4.5], [0.4, 0, 4]], np.float32)
    faces = np.array([[0, 1, 2], [0, 1, 3]], np.int32)  # The first one's plane holds the camera.
    mesh = Mesh(corners, faces, np.full((4, 3), 200, np.uint8))
    bound = bind(mesh, per_triangle=1, thickness=1e-6, sh_degree=0, pixel_filter="mip")
    camera = camera_at(size=(24, 24))

    @jax.jit
    @jax.value_and_grad
    def brightness(vertices):
        moved = replace(bound, vertices=vertices)
        return jnp.mean(rendering.render(moved, camera, capacity=256, background=jnp.zeros(3, jnp.float32)).colors)

    value, gradient = brightness(bound.vertices)
    assert float(value) > 0.001
    assert bool(jnp.isfinite(gradient).all()) and float(jnp.abs(gradient[3]).max()) > 0
