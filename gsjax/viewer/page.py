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
from gsjax.scene.colors import to_bytes
from gsjax.viewer.desk import Desk, Order
from gsjax.viewer.drawing import bare_background
from gsjax.viewer.page_camera import PageCamera, camera_of, page_camera, picture_size
from gsjax.viewer.pictures import COLOR, DEPTH, NORMALS, Pictures
from gsjax.viewer.same_origin import guarded
from gsjax.viewer.scenery import MESH_COLORS, MESH_OFF, MESH_SHAPE, Scenery
from gsjax.viewer.subject import Subject

HOST, PORT = "127.0.0.1", 8080
SHOW, SIDE, MESH, CAMERAS = "Show", "Longest side", "Mesh", "Cameras"
BY_BROWSER = "colour, drawn by the browser"
LONGEST, COARSER = ("480", "960", "1920"), 3  # Sides of full pictures; coarse ones are so much smaller.
BEHIND_SIDE = 64  # Longest side of the picture of what is behind the browser's own splats: a colour, or a smooth sky.
PATIENCE = 0.5  # Seconds between two looks for news.


class News(NamedTuple):
    """What a training hands out."""

    gaussians: Gaussians
    line: str
    background: np.ndarray | None = None  # where it is learned, see `gsjax.rendering.backdrop`; None: the subject's


class Page:
    """A page that is served while the context lasts, and answered by `work`."""

    def __init__(
        self,
        subject: Subject,
        *,
        host: str,
        port: int,
        news: Callable[[], News | None] | None = None,
        share: float = 1.0,
    ):
        """Not served yet.

        Args:
            subject: What to show.
            host: Address to listen on.
            port: 0 takes a free one.
            news: Asked now and then, while somebody looks, for Gaussians to show instead.
            share: Of the time since `work` began, what answering may take.
        """
        self.subject, self.desk = subject, Desk()
        self._host, self._port = host, port
        self._news, self._share = news, share
        self._pictures, self._gaussians, self._line = Pictures(subject), subject.gaussians, ""
        self._background = subject.background
        self._chores: deque[Callable[[], None]] = deque()
        self._closing = Event()
        self.switches: dict[str, Any] = {}  # by their labels, once it is served: each has a `value`

    def __enter__(self) -> Self:
        """Serve.

        Raises:
            InputError: The port is in use, or the host is none of this machine's.
        """
        check_port(self._host, self._port)
        with _silent(), guarded(self._host):
            label = f"gsjax: {self.subject.name}"
            self.server = viser.ViserServer(host=self._host, port=self._port, label=label, verbose=False)
        if self._port not in (0, self.server.get_port()):  # Taken since; viser goes on to the next.
            self.close()
            raise InputError(f"--port {self._port}: is in use")
        self._scenery = Scenery(self.server, self.subject, self._soon)
        self._place_camera()
        self._add_switches()
        return self

    def __exit__(self, *_: object) -> None:
        """Serve no more."""
        self.close()

    @property
    def address(self) -> str:
        """Where a browser finds it."""
        host = "localhost" if self._host in ("0.0.0.0", "::") else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.server.get_port()}"

    def close(self) -> None:
        """Serve no more, and let `work` return."""
        self._closing.set()
        self.desk.close()
        with _silent():
            self.server.stop()

    def work(self) -> None:
        """Answers the page until it is closed: a picture and a bit of what else there is to do, in turn."""
        began, spent = time.monotonic(), 0.0
        while not self.desk.is_closed:
            order = self.desk.take(0 if self._chores else None if self._news is None else PATIENCE)
            started = time.monotonic()
            if order is not None:
                self._answer(order)
            if self._chores:
                self._chores.popleft()()
            self._look_for_news()
            now = time.monotonic()
            spent += now - started
            if self._share < 1:
                self._closing.wait(max(0.0, spent / self._share - (now - began)))

    def _place_camera(self) -> None:
        """Where every browser looks from first."""
        subject, start = self.subject, page_camera(self.subject.start)
        forward = np.asarray(subject.start.viewmat, np.float64)[2, :3]
        ahead = float((subject.middle - start.position) @ forward)
        self.server.scene.set_up_direction(subject.up)
        first = self.server.initial_camera
        first.position, first.up, first.fov = start.position, subject.up, start.fov
        first.look_at = start.position + (ahead if ahead > 0 else subject.scale) * forward
        first.near, first.far = 1e-3 * subject.scale, 1e3 * subject.scale

    def _add_switches(self) -> None:
        """As far as the subject has what they switch."""
        gui, subject = self.server.gui, self.subject
        gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=True)  # A share is not local.
        has_gaussians = subject.gaussians is not None or self._news is not None
        if has_gaussians:
            self._status = gui.add_markdown("The first picture of a kind and size takes longest.")
            first = COLOR if self._news is None else BY_BROWSER
            shown = (COLOR, BY_BROWSER, DEPTH, NORMALS)
            self.switches |= {
                SHOW: gui.add_dropdown(SHOW, shown, initial_value=first),
                SIDE: gui.add_dropdown(SIDE, LONGEST, initial_value="960"),
            }
            for switch in self.switches.values():
                switch.on_update(lambda _: self.desk.again())
            self.server.on_client_connect(self._come)
            self.server.on_client_disconnect(self._leave)
        if subject.mesh is not None:
            choices = (MESH_OFF, MESH_COLORS, MESH_SHAPE)
            mesh = gui.add_dropdown(MESH, choices, initial_value=MESH_OFF if has_gaussians else MESH_COLORS)
            mesh.on_update(lambda _: self._soon(lambda: self._scenery.show_mesh(mesh.value)))
            self._soon(lambda: self._scenery.show_mesh(mesh.value))
            self.switches[MESH] = mesh
        if subject.cameras:
            cameras = gui.add_checkbox(CAMERAS, initial_value=False)
            cameras.on_update(lambda _: self._soon(lambda: self._scenery.show_cameras(cameras.value)))
            self.switches[CAMERAS] = cameras

    async def _come(self, client: viser.ClientHandle) -> None:
        """A browser is there: what it looks at is noted from now on."""

        async def moved(camera: viser.CameraHandle) -> None:
            self.desk.moved(client.client_id, _told(camera))

        client.camera.on_update(moved)
        await moved(client.camera)

    async def _leave(self, client: viser.ClientHandle) -> None:
        """Nothing of it is kept. In viser's own thread, as `_come`, so in the order in which it happened."""
        self.desk.left(client.client_id)

    def _soon(self, chore: Callable[[], None]) -> None:
        self._chores.append(chore)
        self.desk.wake()

    def _answer(self, order: Order) -> None:
        """Draws what was ordered and sends it, if the browser is still there."""
        client = self.server.get_clients().get(order.who)
        if client is None or self._gaussians is None:
            return
        if self.switches[SHOW].value == BY_BROWSER:
            self._scenery.show_splats(self._gaussians)
            behind = camera_of(order.camera, picture_size(order.camera, BEHIND_SIDE))
            if order.is_full and behind is not None:
                self._say(self._line)
                _send(client, to_bytes(bare_background(self._background, behind)), "png")
            return
        self._scenery.hide_splats()
        longest = int(self.switches[SIDE].value) // (1 if order.is_full else COARSER)
        camera = camera_of(order.camera, picture_size(order.camera, longest))
        if camera is None:
            return
        started = time.perf_counter()
        try:
            kind = self.switches[SHOW].value
            picture = self._pictures.draw(kind, self._gaussians, camera, self._background)
        except InputError as error:
            self._say(str(error))
            return
        if order.is_full:
            shown = f"{camera.width}x{camera.height} in {1e3 * (time.perf_counter() - started):.0f} ms"
            self._say(", ".join(filter(None, (shown, self._line))))
        _send(client, picture, "png" if order.is_full else "jpeg")

    def _say(self, line: str) -> None:
        with _whoever_is_left():
            self._status.content = line

    def _look_for_news(self) -> None:
        """Newer Gaussians, where they are made and somebody looks."""
        news = self._news() if self._news is not None and len(self.desk) else None
        if news is not None:
            self._gaussians, self._line = news.gaussians, news.line
            self._background = self.subject.background if news.background is None else news.background
            self.desk.again(only_full=True)


def check_port(host: str = HOST, port: int = PORT) -> None:
    """InputError unless a server could listen there."""
    if not 0 <= port < 65536:
        raise InputError(f"--port {port} is not between 0 and 65535")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except socket.gaierror as error:
        raise InputError(f"--host {host}: {error.strerror}") from error
    except UnicodeError as error:  # Of a name that no address can have, such as an empty or a very long part.
        raise InputError(f"--host {host}: is no name of a host") from error
    except OSError as error:
        way_out = "; choose another with --port" if error.errno == errno.EADDRINUSE else ""
        raise InputError(f"--port {port} on {host}: {error.strerror}{way_out}") from error


def _told(camera: viser.CameraHandle) -> PageCamera:
    return PageCamera(camera.position, camera.wxyz, camera.fov, camera.image_width, camera.image_height)


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
