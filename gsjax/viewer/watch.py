"""What the commands call: a result on a page, or a training."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread

import jax
import jax.numpy as jnp
import numpy as np

from gsjax.io.scenes import load_scene
from gsjax.settings import Settings
from gsjax.training.loop import Progress
from gsjax.viewer.page import HOST, PORT, News, Page, check_port
from gsjax.viewer.viewed_scene import open_viewed_scene, view_data_set

SHARE = 0.03  # Of a training's time, what its page may take.
EVERY = 5.0  # Seconds between two snapshots, at least.


def view(source: str | Path, *, mesh: str | Path | None = None, host: str = HOST, port: int = PORT) -> None:
    """Serve a page that shows a result, until it is interrupted.

    Args:
        source: A run folder; a file of Gaussians (.ply, .compressed.ply, .sog, .spz); or a mesh (.ply, .obj, .glb).
        mesh: A mesh to show over Gaussians; None: `mesh.ply` of a run that has one.
        host: Address to listen on; 127.0.0.1 is this machine alone.
        port: 0 takes a free one.

    Raises:
        InputError: The source or the mesh cannot be read, or the port is in use.
    """
    check_port(host, port)
    viewed = open_viewed_scene(source, mesh=mesh, notify=_tell)
    with suppress(KeyboardInterrupt), Page(viewed, host=host, port=port) as page:
        _tell(f"{page.address} shows {viewed.name}; Ctrl-C ends it")
        page.work()


@contextmanager
def watch(
    scene: str | Path, settings: Settings, *, host: str = HOST, port: int = PORT
) -> Iterator[Callable[[Progress], None]]:
    """Serve a page that shows a training while the context lasts.

    Its Gaussians are copied every few seconds while a browser looks. What the page takes, compilation and drawing
    included, is kept to `SHARE` of the time since it opened. Host and port are those of `view`.

    Yields:
        The observer of every step, see `gsjax.pipeline.train`.

    Raises:
        InputError: The data set cannot be read, or the port is in use.
    """
    check_port(host, port)
    loaded = load_scene(
        scene,
        downscale=settings.photos.downscale or 1,
        folder_masks=settings.photos.masks,
        images=settings.photos.images,
        hold_out=settings.photos.hold_out,
        photos=settings.photos.subset,
    )
    viewed = view_data_set(Path(scene).resolve().name, loaded, settings.model.background, settings.model.depth_mode)
    snapshots = Snapshots(settings.schedule.steps)
    with Page(viewed, host=host, port=port, news=snapshots.news, share=SHARE) as page:
        _tell(f"{page.address} shows the running training")
        answering = Thread(target=page.work, name="page")
        answering.start()
        try:
            yield snapshots.observe
        finally:
            page.close()
            answering.join()


class Snapshots:
    """Pass Gaussians of a training, which reports every step, to the page, which requests them now and then.

    A step without a request costs one test of a flag.
    """

    def __init__(self, steps: int, *, every: float = EVERY, clock: Callable[[], float] = time.monotonic):
        self._steps, self._every, self._clock = steps, every, clock
        self._asked, self._taken, self._asked_at = Event(), None, -float("inf")

    def observe(self, progress: Progress) -> None:
        """Receive the report of a step, in the training's own thread."""
        if self._asked.is_set():
            self._asked.clear()
            # The next step takes the buffers.
            gaussians = jax.tree.map(jnp.copy, progress.state.gaussians)
            effects = progress.state.effects
            background = None if effects is None else effects.numbers.get("background")
            self._taken = News(
                gaussians,
                f"{progress.phase.name}: step {progress.step:,} of {self._steps:,}",
                None if background is None else np.array(background),
            )

    def news(self) -> News | None:
        """What was copied since the last call, if anything; requests the next where it is time."""
        news, self._taken = self._taken, None
        if self._clock() - self._asked_at >= self._every and not self._asked.is_set():
            self._asked_at = self._clock()
            self._asked.set()
        return news


def _tell(line: str) -> None:
    print(f"view: {line}", file=sys.stderr)
