"""What the browser draws by itself: splats, a mesh, the cameras with their photos."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import viser

from gsjax.errors import InputError
from gsjax.gaussians import SH_C0, Gaussians, covariances, is_alive, opacities
from gsjax.io.images import resize
from gsjax.meshing.export import glb_bytes, read_mesh
from gsjax.viewer.page_camera import page_camera
from gsjax.viewer.viewed_scene import ViewedScene

MESH_OFF, MESH_COLORS, MESH_SHAPE = "off", "colours", "shape"
THUMBNAIL = 160  # Longest side of a photo in the scene, pixels.
FRUSTUM = 0.04  # Length of a camera, in distances from the first camera to the middle.


class Scenery:
    """Things of a viewed in the scene of a server, each sent to browsers when it is first shown."""

    def __init__(self, server: viser.ViserServer, viewed: ViewedScene, soon: Callable[[Callable[[], None]], None]):
        """Nothing is there yet; long work is given to `soon`, bit by bit."""
        self._scene, self._viewed, self._soon = server.scene, viewed, soon
        self._splats_of: Gaussians | None = None
        # A sky and the first camera's own light: viser's light comes from a photo, and with shadows.
        self._scene.configure_environment_map(None)
        self._scene.configure_default_lights(enabled=False)
        self._scene.add_light_hemisphere(
            "/lights/sky", sky_color=(255, 255, 255), ground_color=(90, 90, 90), intensity=2.0
        )
        eye = page_camera(viewed.start).position
        self._scene.add_light_directional("/lights/start", position=eye - viewed.middle, intensity=1.5)

    def show_splats(self, gaussians: Gaussians) -> None:
        """Send Gaussians to the browser, unless it has them."""
        if self._splats_of is not gaussians:
            self._scene.add_gaussian_splats("/splats", **browser_splats(gaussians))
            self._splats_of = gaussians
        self._set_visible("/splats", True)

    def hide_splats(self) -> None:
        """What the rasterizer draws is behind them."""
        self._set_visible("/splats", False)

    def show_mesh(self, choice: str) -> None:
        """The mesh in its colours, as a grey shape, or not at all."""
        file, similarity = self._viewed.mesh, self._viewed.similarity
        if file is not None and self._scene.get_handle_by_name(f"/mesh/{choice}") is None:
            if choice == MESH_COLORS:
                place = similarity.length_to_local(-np.asarray(similarity.center))
                self._scene.add_glb(f"/mesh/{choice}", glb_bytes(file), scale=similarity.scale, position=place)
            elif choice == MESH_SHAPE:
                mesh = similarity.mesh_to_local(read_mesh(file))
                look = {"color": (200, 200, 200), "flat_shading": True, "side": "double"}
                self._scene.add_mesh_simple(f"/mesh/{choice}", mesh.vertices, mesh.faces, **look)
        for name in (MESH_COLORS, MESH_SHAPE):
            self._set_visible(f"/mesh/{name}", name == choice)

    def show_cameras(self, visible: bool) -> None:
        """Show or hide all cameras; they are added one by one at first."""
        if visible and self._scene.get_handle_by_name("/cameras") is None:
            self._scene.add_frame("/cameras", show_axes=False)
            for index, name in enumerate(self._viewed.cameras):
                self._soon(partial(self._add_camera, index, name))
        self._set_visible("/cameras", visible)

    def _add_camera(self, index: int, name: str) -> None:
        """A camera in the scene, with its photo where that can be read; a click on it looks from there."""
        at = page_camera(self._viewed.cameras[name])
        frustum = self._scene.add_camera_frustum(
            f"/cameras/{index:05d}",
            at.fov,
            at.width / at.height,
            scale=FRUSTUM * self._viewed.scale,
            thickness=1.0,
            thickness_units="screen",
            color=(255, 160, 40),
            image=self._thumbnail(name),
            wxyz=at.wxyz,
            position=at.position,
        )

        @frustum.on_click
        def _(event: viser.SceneNodePointerEvent) -> None:
            camera = event.client.camera
            with event.client.atomic():
                camera.position, camera.wxyz, camera.fov = at.position, at.wxyz, at.fov

    def _thumbnail(self, name: str) -> np.ndarray | None:
        frame = self._viewed.photos.get(name)
        if frame is None:
            return None
        try:
            image = frame.pixels().image
        except InputError:
            return None
        factor = max(1.0, max(frame.width, frame.height) / THUMBNAIL)
        return resize(image, round(frame.width / factor), round(frame.height / factor))

    def _set_visible(self, name: str, visible: bool) -> None:
        node = self._scene.get_handle_by_name(name)
        if node is not None and node.visible != visible:
            node.visible = visible


def browser_splats(gaussians: Gaussians) -> dict[str, Any]:
    """The Gaussians that are alive as a browser draws them: without harmonics, filters or depth, but at once.

    Returns:
        What viser takes, float32: `[N, 3]` `centers` and `[N, 3, 3]` `covariances`, world; `[N, 3]` `rgbs` of degree 0
        and `[N, 1]` `opacities`, 0..1.
    """
    alive, *arrays = (np.asarray(x) for x in _linear(gaussians))
    return dict(zip(("centers", "covariances", "rgbs", "opacities"), (array[alive] for array in arrays), strict=True))


@jax.jit
def _linear(gaussians: Gaussians) -> tuple[jax.Array, ...]:
    """For the whole buffer, so that one program serves however many rows are alive."""
    rgbs = jnp.clip(SH_C0 * gaussians.sh_dc[:, 0] + 0.5, 0, 1)
    return is_alive(gaussians), gaussians.means, covariances(gaussians), rgbs, opacities(gaussians)[:, None]
