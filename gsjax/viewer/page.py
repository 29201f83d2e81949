"""The page itself: its server and switches, and the loop that answers it."""

import errno
import socket
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event
from typing import Any, Literal, NamedTuple, Self

import numpy as np
import rich
import viser

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.viewer.page_camera import PageCamera, camera_of, page_camera, picture_size
from gsjax.viewer.picture_queue import PictureQueue, Request
from gsjax.viewer.pictures import COLOR, DEPTH, NORMALS, bare_background, draw_picture
from gsjax.viewer.same_origin import guarded
from gsjax.viewer.scenery import MESH_COLORS, MESH_OFF, MESH_SHAPE, Scenery
from gsjax.viewer.viewed_scene import ViewedScene

HOST, PORT = "127.0.0.1", 8080
SHOW, SIDE, MESH, CAMERAS = "Show", "Longest side", "Mesh", "Cameras"
BY_BROWSER = "colour, drawn by the browser"
LONGEST, COARSER = ("480", "960", "1920"), 3  # Sides of full pictures; coarse ones are so much smaller.
BEHIND_SIDE = 64  # Longest side of the picture of what is behind the browser's own splats: a colour, or a smooth sky.
PATIENCE = 0.5  # Seconds between two looks for news.


class News(NamedTuple):
    """What a training passes to the page."""

    gaussians: Gaussians | None  # None: not yet
    line: str
    background: np.ndarray | None = None  # where it is learned, see `gsjax.rendering.backdrop`; None: the viewed's


class Page:
    """A page that is served while the context lasts, and answered by `work`."""

    def __init__(
        self,
        viewed: ViewedScene,
        *,
        host: str,
        port: int,
        news: Callable[[], News | None] | None = None,
        share: float = 1.0,
    ):
        """Not served yet; port 0 takes a free one.

        While users look, `news` returns Gaussians to show instead. `share` is of the time since `work` began, what
        answering may take.
        """
        self.viewed, self.queue = viewed, PictureQueue()
        self._host, self._port = host, port
        self._news, self._share = news, share
        self._newest = News(viewed.gaussians, "", viewed.background)
        self._chores: deque[Callable[[], None]] = deque()
        self._closing = Event()
        self.switches: dict[str, Any] = {}  # by their labels, once it is served: each has a `value`

    def __enter__(self) -> Self:
        """Serve; InputError where the port is in use, or the host is none of this machine's."""
        check_port(self._host, self._port)
        with _silent(), guarded(self._host):
            label = f"gsjax: {self.viewed.name}"
            self.server = viser.ViserServer(host=self._host, port=self._port, label=label, verbose=False)
        if self._port not in (0, self.server.get_port()):  # Taken since; viser goes on to the next.
            self.close()
            raise InputError(f"port={self._port}: is in use")
        self._scenery = Scenery(self.server, self.viewed, self._soon)
        self._place_camera()
        self._add_switches()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def address(self) -> str:
        """Where a browser finds it."""
        host = "localhost" if self._host in ("0.0.0.0", "::") else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.server.get_port()}"

    def close(self) -> None:
        """Serve no more, and let `work` return."""
        self._closing.set()
        self.queue.close()
        with _silent():
            self.server.stop()

    def work(self) -> None:
        """Answers the page until it is closed: a picture and a bit of what else there is to do, in turn."""
        began, spent = time.monotonic(), 0.0
        while not self.queue.is_closed:
            request = self.queue.take(0 if self._chores else None if self._news is None else PATIENCE)
            started = time.monotonic()
            if request is not None:
                self._answer(request)
            if self._chores:
                with _whoever_is_left():
                    self._chores.popleft()()
            self._look_for_news()
            now = time.monotonic()
            spent += now - started
            if self._share < 1:
                self._closing.wait(max(0.0, spent / self._share - (now - began)))

    def _place_camera(self) -> None:
        """Where every browser looks from first."""
        viewed, start = self.viewed, page_camera(self.viewed.start)
        forward = np.asarray(viewed.start.viewmat, np.float64)[2, :3]
        ahead = float((viewed.middle - start.position) @ forward)
        self.server.scene.set_up_direction(viewed.up)
        first = self.server.initial_camera
        first.position, first.up, first.fov = start.position, viewed.up, start.fov
        first.look_at = start.position + (ahead if ahead > 0 else viewed.scale) * forward
        first.near, first.far = 1e-3 * viewed.scale, 1e3 * viewed.scale

    def _add_switches(self) -> None:
        """As far as the viewed has what they switch."""
        gui, viewed = self.server.gui, self.viewed
        gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=True)  # A share is not local.
        has_gaussians = viewed.gaussians is not None or self._news is not None
        if has_gaussians:
            self._status = gui.add_markdown("The first picture of a kind and size takes longest.")
            first = COLOR if self._news is None else BY_BROWSER
            kinds = (COLOR, BY_BROWSER, DEPTH, NORMALS)
            self.switches |= {
                SHOW: gui.add_dropdown(SHOW, kinds, initial_value=first),
                SIDE: gui.add_dropdown(SIDE, LONGEST, initial_value="960"),
            }
            for switch in self.switches.values():
                switch.on_update(lambda _: self.queue.redraw())
            self.server.on_client_connect(self._come)
            self.server.on_client_disconnect(self._leave)
        if viewed.mesh is not None:
            choices = (MESH_OFF, MESH_COLORS, MESH_SHAPE)
            mesh = gui.add_dropdown(MESH, choices, initial_value=MESH_OFF if has_gaussians else MESH_COLORS)
            mesh.on_update(lambda _: self._soon(lambda: self._scenery.show_mesh(mesh.value)))
            self._soon(lambda: self._scenery.show_mesh(mesh.value))
            self.switches[MESH] = mesh
        if viewed.cameras:
            cameras = gui.add_checkbox(CAMERAS, initial_value=False)
            cameras.on_update(lambda _: self._soon(lambda: self._scenery.show_cameras(cameras.value)))
            self.switches[CAMERAS] = cameras

    async def _come(self, client: viser.ClientHandle) -> None:
        """A browser has connected: its camera is noted from now on."""

        async def moved(camera: viser.CameraHandle) -> None:
            place = PageCamera(camera.position, camera.wxyz, camera.fov, camera.image_width, camera.image_height)
            self.queue.move(client.client_id, place)

        client.camera.on_update(moved)
        await moved(client.camera)

    async def _leave(self, client: viser.ClientHandle) -> None:
        """Nothing of it is kept. In viser's own thread, as `_come`, so in the request in which it happened."""
        self.queue.remove(client.client_id)

    def _soon(self, chore: Callable[[], None]) -> None:
        self._chores.append(chore)
        self.queue.wake()

    def _answer(self, request: Request) -> None:
        """Draws what was ordered and sends it, if the browser is still there."""
        client, kind = self.server.get_clients().get(request.browser), self.switches[SHOW].value
        gaussians, line, background = self._newest
        if client is None or gaussians is None:
            return
        if kind == BY_BROWSER:
            self._scenery.show_splats(gaussians)
            behind = camera_of(request.camera, picture_size(request.camera, BEHIND_SIDE))
            if request.is_full and behind is not None:
                self._say(line)
                _send(client, bare_background(background, behind), "png")
            return
        self._scenery.hide_splats()
        longest = int(self.switches[SIDE].value) // (1 if request.is_full else COARSER)
        camera = camera_of(request.camera, picture_size(request.camera, longest))
        if camera is None:
            return
        started = time.perf_counter()
        try:
            picture = draw_picture(kind, gaussians, camera, background, self.viewed.depth_mode)
        except InputError as error:
            self._say(str(error))
            return
        if request.is_full:
            timing = f"{camera.width}x{camera.height} in {1e3 * (time.perf_counter() - started):.0f} ms"
            self._say(", ".join(filter(None, (timing, line))))
        _send(client, picture, "png" if request.is_full else "jpeg")

    def _say(self, line: str) -> None:
        with _whoever_is_left():
            self._status.content = line

    def _look_for_news(self) -> None:
        """Newer Gaussians, where they are made and somebody looks."""
        news = self._news() if self._news is not None and len(self.queue) else None
        if news is not None:
            is_bare = news.background is None
            self._newest = news._replace(background=self.viewed.background) if is_bare else news
            self.queue.redraw(only_full=True)


def check_port(host: str = HOST, port: int = PORT) -> None:
    """InputError unless a server could listen there."""
    if not 0 <= port < 65536:
        raise InputError(f"port={port} is not between 0 and 65535")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except socket.gaierror as error:
        raise InputError(f"host={host}: {error.strerror}") from error
    except UnicodeError as error:  # Of a name that no address can have, such as an empty or a very long part.
        raise InputError(f"host={host}: is no name of a host") from error
    except OSError as error:
        way_out = "; choose another port" if error.errno == errno.EADDRINUSE else ""
        raise InputError(f"port={port} on {host}: {error.strerror}{way_out}") from error


def _send(client: viser.ClientHandle, picture: np.ndarray, form: Literal["png", "jpeg"]) -> None:
    """Behind everything else on a page."""
    with _whoever_is_left():
        client.scene.set_background_image(picture, format=form)


@contextmanager
def _whoever_is_left() -> Iterator[None]:
    """A page that was left meanwhile, or a server that was stopped, does not matter."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection")
        yield


@contextmanager
def _silent() -> Iterator[None]:
    """Without the banners that viser prints."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
